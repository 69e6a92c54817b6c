// What the numbers mean, in words; and the loop as TOML and as a command.

import { short } from "./chart.js";

/** Parameters that name a linear loop, in the order in which they are written. */
const OF_LOOP = [
  "kp",
  "kd",
  "mass",
  "joint_damping",
  "joint_stiffness",
  "wn",
  "zeta",
  "delay",
  "measurement_delay",
  "output_delay",
  "setpoint_delay",
  "control_rate",
  "velocity_filter",
];
const DEFAULTS = {
  joint_damping: 0,
  joint_stiffness: 0,
  wn: Infinity,
  delay: 0,
  measurement_delay: 0,
  output_delay: 0,
  setpoint_delay: 0,
  velocity_filter: Infinity,
};

/** The margins and the stability of a loop in a few sentences; `root` of `rightmostRoot`. */
export function verdict({ parameters: p, kp, kd, unit, margins: m, root, sampled }) {
  const [stiff, damping] = gainUnits(unit);
  const how = sampled ? `sampled at ${short(p.control_rate)} Hz` : "in continuous time";
  const gains = `kp ${short(kp)} ${stiff}, kd ${short(kd)} ${damping}, ${how}`;
  const swings = root.im > 1e-6 * Math.abs(root.re) ? ` at ${short(root.im)} rad/s` : "";
  if (!m.stable) {
    const number = m.unstable_roots === 1 ? "one root" : `${m.unstable_roots} roots`;
    const what = swings ? "shakes" : "runs away";
    return `Unstable: ${gains}. The joint ${what}${swings}, growing by ${short(root.re)} 1/s (${number}).`;
  }
  const less =
    m.gain_reduction_margin > 0 ? `, or fall to ×${short(m.gain_reduction_margin, 3)}` : "";
  const more =
    m.gain_margin === Infinity ? "may rise without limit" : `may rise ×${short(m.gain_margin, 3)}`;
  const delay =
    m.delay_margin === Infinity
      ? "no delay is too much"
      : `${short(1000 * m.delay_margin, 3)} ms more delay`;
  const phase = Number.isFinite(m.phase_margin)
    ? `, ${short(degrees(m.phase_margin), 3)}° of phase`
    : "";
  return (
    `Stable: ${gains}. Perturbations decay by ${short(-root.re)} 1/s${swings}. ` +
    `Both gains ${more}${less}; what is left is ${delay}${phase}. ` +
    `Ms is ${short(m.sensitivity_peak, 3)}: ${judged(m.sensitivity_peak)}.`
  );
}

/** What a peak of the sensitivity is worth (Astrom and Hagglund: 1.2 to 2 is usual). */
function judged(peak) {
  if (peak <= 1.4) return "robust";
  if (peak <= 2) return "usual";
  return peak <= 3 ? "little robust" : "close to shaking";
}

export const degrees = (radians) => (radians * 180) / Math.PI;

export const gainUnits = (unit) => (unit === "rad" ? ["N m/rad", "N m s/rad"] : ["N/m", "N s/m"]);

/** Parameters that are not what they are by default, by name. */
function given(p, kp, kd) {
  const all = { ...p, kp, kd };
  return OF_LOOP.filter(
    (name) => all[name] !== DEFAULTS[name] && (name !== "zeta" || p.wn < Infinity),
  ).map((name) => [name, all[name]]);
}

const written = (value) => (value === Infinity ? "inf" : String(value));

/** The loop as a TOML file that `jaxact margins --loops` reads. */
export function toml(p, kp, kd, unit) {
  const lines = given(p, kp, kd).map(
    ([name, value]) => `${called(name, unit)} = ${written(value)}`,
  );
  return [`# jaxact margins --loops FILE${velocity(p)}`, "[[loop]]", ...lines].join("\n");
}

/** The command that computes the same margins. */
export function command(p, kp, kd, unit) {
  const options = given(p, kp, kd)
    .filter(([name]) => name !== "setpoint_delay")
    .map(([name, value]) => `--${called(name, unit).replaceAll("_", "-")} ${written(value)}`);
  return `jaxact margins ${options.join(" ")}${velocity(p)}`;
}

const velocity = (p) => (p.velocity === "sampled" ? "" : ` --velocity ${p.velocity}`);

const called = (name, unit) => (name === "mass" && unit === "rad" ? "inertia" : name);

// What is said of a robot: the verdict, the rows of tables and sliders, and how to compute it again.

import { short } from "./chart.js";

/** While something moves: only whether it is stable, null before even that is known. */
export const quick = (unstable) =>
  unstable === null ? "…" : unstable === 0 ? "Stable; …" : "Unstable; …";

const factor = (x) => `×${short(x, 3)}`;
const ms = (x) => `${short(1000 * x, 3)} ms`;

/** The verdict in words; `found` of the page's `settle`. */
export function verdict(found, joints) {
  const { growth, up, down, later, peaks } = found;
  const rate = growth.rate === null ? "a rate that is not known here" : `${short(Math.abs(growth.rate), 3)} 1/s`;
  if (growth.shakes) {
    const first = largest(found.shape, joints);
    return (
      `The robot shakes: perturbations grow by ${rate}, at ${short(growth.frequency ?? NaN, 3)} rad/s` +
      `${growth.topples ? ", and it topples" : ""}. ${first}` +
      `${down && down.after === 0 ? `It is stable with gains ${factor(down.factor)}. ` : ""}`
    ).trim();
  }
  if (growth.topples || !growth.stable) {
    const limits = [
      up ? `gains ${factor(up.factor)}` : "",
      later && later.delay > 0 ? `${ms(later.delay)} more delay` : "",
    ].filter((one) => one);
    const shaking = limits.length ? ` It begins to shake with ${limits.join(", or with ")}.` : "";
    return (
      `The robot leaves its posture without shaking, by ${rate}: what is missing is a balance controller, ` +
      `or gains that hold it. Margins of an unstable loop mean nothing.${shaking}`
    );
  }
  const more = up ? `may all rise to ${factor(up.factor)}` : "may all rise without end";
  const less = down ? ` and fall to ${factor(down.factor)}` : "";
  const delay = !later
    ? "no common delay makes it shake"
    : Number.isNaN(later.delay)
      ? "its delay margin is not known here"
      : `${ms(later.delay)} of delay are left`;
  return (
    `Stable: perturbations decay by ${rate}. The gains ${more}${less}; ${delay}. ` +
    `Ms of all joints at once is ${short(peaks.sensitivity_peak, 3)}. ${largest(found.shape, joints)}`
  ).trim();
}

function largest(shape, joints) {
  if (!shape) return "";
  const order = joints.map((_, i) => i).sort((a, b) => shape[b].share - shape[a].share);
  const percent = (i) => `${joints[i]} (${Math.round(100 * shape[i].share)} %)`;
  return `First to shake: ${order.slice(0, 2).map(percent).join(", ")}. `;
}

/** What the picture of the motion shows. */
export function shapeSays({ growth, later, up, shape }) {
  if (!shape) return "No motion shakes, whatever delay or gain is added";
  if (growth.shakes) return "The motion that grows: amplitudes, and phases as hands";
  const when = later
    ? `with ${ms(later.delay)} more delay`
    : `with gains ${factor(up.factor)}`;
  return `The motion that shakes first, ${when}: amplitudes, and phases as hands`;
}

/** Rows of the table of all joints at once. */
export function rows({ growth, peaks, up, down, later, disk }, period) {
  const row = (name, label, value, text) => ({ name, label, value, text });
  const known = (value) => (value === null || Number.isNaN(value) ? "not known here" : short(value));
  const found = [
    row("stable", "is it stable?", growth.stable, growth.stable ? "yes" : "NO"),
    row("unstable_roots", "growing motions", growth.unstable_roots, `${growth.unstable_roots}`),
    row("growth_rate", "growth rate [1/s]", growth.rate, known(growth.rate)),
    row("frequency", "its frequency [rad/s]", growth.frequency, known(growth.frequency)),
  ];
  const shakes = growth.stable ? "" : growth.shakes ? ": number of motions changes" : ": begins to shake";
  const [high, low] = [up?.factor ?? Infinity, down?.factor ?? 0];
  const where = (name, limit) => {
    const frequency = limit ? limit.t / period : Infinity;
    if (limit) found.push(row(`${name}_frequency`, "where [rad/s]", frequency, short(frequency)));
  };
  found.push(row("gain_margin", `gains up${shakes} [×]`, high, short(high)));
  where("gain_margin", up);
  found.push(row("gain_reduction_margin", `gains down${shakes} [×]`, low, short(low)));
  where("gain_reduction", down);
  if (!growth.shakes) {
    const delay = later ? later.delay : Infinity;
    found.push(row("delay_margin", `more delay${shakes} [ms]`, delay, known(1000 * delay)));
    where("delay_margin", Number.isNaN(delay) ? null : later);
  }
  if (!peaks) return found;
  const labels = {
    sensitivity_peak: "Ms, peak of σmax S",
    sensitivity_peak_frequency: "where [rad/s]",
    complementary_peak: "Mt, peak of σmax T",
    complementary_peak_frequency: "where [rad/s]",
    modulus_margin: "modulus margin, 1/Ms",
    unscaled_disk_margin: "disk margin, full-block uncertainty",
  };
  for (const [name, label] of Object.entries(labels)) {
    found.push(row(name, label, peaks[name], short(peaks[name])));
  }
  return [...found, ...diskRows(disk)];
}

/** Rows of the disk margin of all joints, each changed by itself; it comes last, and is undefined before. */
function diskRows(disk) {
  const { margin, frequency } = disk ?? {};
  const row = (name, label, value, text) => ({ name, label, value, text: disk ? text(value) : "…" });
  return [
    row("disk_margin", "disk margin, joints independently", margin, short),
    row("disk_margin_frequency", "where [rad/s]", frequency, short),
    row("guaranteed", "it guarantees of each joint", margin, guaranteed),
  ];
}

/** Gains and phase of each joint that a balanced disk margin guarantees. */
function guaranteed(margin) {
  const [low, high] = [(2 - margin) / (2 + margin), margin < 2 ? (2 + margin) / (2 - margin) : Infinity];
  const angle = (360 / Math.PI) * Math.atan(margin / 2);
  return `gains ×${short(Math.max(low, 0), 3)} to ×${short(high, 3)}, phase ±${short(angle, 3)}°`;
}

const differ = (values) => values.some((one) => one !== values[0]);

/** Sliders of the whole robot. */
export function controlRows(start, window, drives) {
  const of = (name) => (differ(drives[name]) ? ", of the first joint; others in proportion" : "");
  const around = (value, low, high) =>
    value > 0 && value < Infinity
      ? [Math.min(low, value / 4), Math.max(high, value * 4)]
      : [low, high];
  return [
    { name: "gain_scale", label: "factor on all gains", unit: "×", log: true, range: window.factor, factor: 1 },
    {
      name: "delay",
      label: `delay of the commands${differ(drives.delay) ? ", of the quickest joint" : ""}`,
      unit: "ms",
      log: false,
      range: window.delay,
      factor: 1000,
    },
    {
      name: "wn",
      label: `wn, natural frequency of the actuators${of("wn")}`,
      unit: "rad/s",
      log: true,
      range: around(start.wn, 10, 5000),
      infinite: "ideal actuators",
      factor: 1,
    },
    {
      name: "zeta",
      label: `zeta, their damping ratio${of("zeta")}`,
      unit: "",
      log: true,
      range: around(start.zeta, 0.05, 2),
      factor: 1,
    },
  ];
}

/** Sliders of the groups: factors on kp and on kd. */
export const groupRows = (groups, drives) =>
  groups.flatMap(([name, places], i) =>
    ["kp", "kd"]
      // A factor on gains that are zero, kd hidden in the joints' damping say, would move nothing.
      .filter((gain) => places.some((joint) => drives[gain][joint] !== 0))
      .map((gain) => ({
        name: `${gain}_${i}`,
        label: `${gain} of ${name}`,
        unit: "×",
        log: true,
        range: [0.1, 10],
        factor: 1,
      })),
  );

/** Values by key that say what the joints have: once where they have it in common. */
function values(data, state, drives) {
  const found = [["control_rate", Number(state.rate)], ...Object.entries(data.loops[state.loop].changes)];
  const names = ["kp", "kd", "wn", "zeta", "delay", "measurement_delay", "output_delay", "velocity_filter"];
  for (const name of names) {
    const own = drives[name];
    if (!differ(own)) {
      if (own[0] !== DEFAULTS[name] && !(name === "zeta" && drives.wn[0] === Infinity)) {
        found.push([name, own[0]]);
      }
      continue;
    }
    data.patterns.forEach((pattern, i) => found.push([`${name}@${pattern}`, own[i]]));
  }
  return found;
}

// Of what no model brings: anything else is said, as the model may have it otherwise.
const DEFAULTS = {
  measurement_delay: 0,
  output_delay: 0,
  velocity_filter: Infinity,
};

const written = (value) => (value === Infinity ? "inf" : String(value));
const quoted = (text) => (/^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", "'\\''")}'`);

/** The command that computes the same margins. */
export function command(data, state, drives) {
  const plain = [];
  const own = [];
  for (const [key, value] of [...values(data, state, drives), ...Object.entries(data.options)]) {
    if (key in drives || key === "control_rate") {
      plain.push(`--${key.replaceAll("_", "-")} ${written(value)}`);
    } else own.push(`--set ${quoted(`${key}=${written(value)}`)}`);
  }
  const velocity = data.velocity === "sampled" ? [] : [`--velocity ${data.velocity}`];
  return ["jaxact margins", ...data.mounting.map(quoted), ...plain, ...own, ...velocity].join(" ");
}

/** The same as a specification. */
export function toml(data, state, drives) {
  const lines = values(data, state, drives).map(
    ([key, value]) => `${key.includes("@") ? JSON.stringify(key) : key} = ${written(value)}`,
  );
  const velocity = data.velocity === "sampled" ? [] : [`velocity = "${data.velocity}"\n`];
  const options = Object.entries(data.options).map(([name, value]) => `${name} = ${value}\n`);
  const head = [...velocity, ...options].join("");
  return `# jaxact margins --spec FILE\n${head}${data.plant}\n[parameters]\n${lines.join("\n")}`;
}

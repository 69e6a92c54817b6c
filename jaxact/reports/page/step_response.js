// The sampled loop's answer to a step of its setpoint, exact between the switching instants.

import { periodMap, within } from "./loops.js";
import { applied } from "./transition.js";

const MOST_TICKS = 2000;

/** Long enough for the slowest motion to decay, in control periods; `root` of `rightmostRoot`. */
export function ticksOf({ control_rate: rate }, root) {
  const period = root.im > 0 ? (2 * Math.PI) / root.im : 0;
  const time = Math.max(root.re < 0 ? 6 / -root.re : 0, 4 * period, 20 / rate);
  return Math.min(Math.ceil(time * rate), MOST_TICKS);
}

/** A number of periods, whole where it is so within rounding. */
const wholeOrNot = (x) => (Math.abs(x - Math.round(x)) < 1e-9 * (1 + x) ? Math.round(x) : x);

/**
 * Position of the joint at every control tick after a unit step at t = 0, from rest; the loop is
 * linear. Returns {time [s], position [-], command [N/m]}, `ticks` + 1 values each.
 *
 * The controller sees the joint as it was `measurement_delay` ago: the state that is stepped is
 * the one it sees, and the joint itself is that much ahead.
 */
export function stepResponse(p, kp, kd, ticks) {
  const period = 1 / p.control_rate;
  const { phi, older, newer, steps, remainder } = periodMap(p);
  const ahead = p.measurement_delay / period;
  const whole = Math.floor(ahead);
  const part = (ahead - whole) * period;
  const late = wholeOrNot(p.setpoint_delay / period);
  const pole = Math.exp(-p.velocity_filter * period);
  const commands = [];
  const held = (i) => (i < 0 ? 0 : commands[i]);
  const seen = [];
  let x = [0, 0, 0, 0];
  let [before, estimate] = [0, 0];
  for (let tick = 0; tick <= ticks + whole + 1; tick++) {
    if (p.velocity === "differenced") {
      estimate = pole * estimate + ((1 - pole) * (x[0] - before)) / period;
    } else {
      estimate = x[1];
    }
    before = x[0];
    // The setpoint is linear between ticks, 0 before the step.
    const goal = Math.min(Math.max(tick - late + 1, 0), 1);
    commands.push(kp * (goal - x[0]) - kd * estimate);
    seen.push(x);
    const [old, now] = [held(tick - steps - 1), held(tick - steps)];
    x = applied(phi, x).map((value, i) => value + older[i] * old + newer[i] * now);
  }
  const positions = [];
  const beside = within(p, remainder, part);
  for (let tick = 0; tick <= ticks; tick++) {
    const at = tick + whole;
    const [old, now] = [held(at - steps - 1), held(at - steps)];
    positions.push(part > 0 ? beside(seen[at], old, now)[0] : seen[at][0]);
  }
  const time = positions.map((_, i) => i * period);
  return { time, position: positions, command: commands.slice(0, ticks + 1) };
}

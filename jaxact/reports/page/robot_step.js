// A robot's answer to a step of one joint's setpoint, with all joints closed: linear and sampled.
//
//   x <- U x + Q^H B f over a physics step, f the mean forces of the actuators over it, exactly;
//   u = kp (setpoint - q) - kd v at every tick, held, as it is measured.

import { actuatorOf, held, instant } from "./robot_servo.js";

const MOST_TICKS = 1000;
const LONGEST = 2;
// Beyond so many steps a motion that grows is not followed.
const FAR = 20;
const PAUSE = 8;

/** Long enough for the slowest motion to decay, in control periods; `growth` of the loop. */
export function ticksOf({ rate }, period) {
  const time = rate < 0 ? Math.min(6 / -rate, LONGEST) : LONGEST;
  return Math.min(Math.max(Math.ceil(time / period), 20), MOST_TICKS);
}

/**
 * Positions of all joints at every tick after a unit step of one joint's setpoint at t = 0, from rest:
 * {time [s], positions}, an array of up to `ticks` + 1 values for each joint; fewer where they grow
 * beyond all bounds. In steps.
 */
export function* stepResponse(plant, drives, differenced, joint, ticks) {
  const { step, substeps } = plant;
  const m = plant.inputs.columns;
  const period = step * substeps;
  const actuators = drives.kp.map((_, i) => held(actuatorOf(drives, i), period, substeps));
  const sensed = drives.measurement_delay.map((late) => instant(late, period, step, substeps));
  const own = mechanics(plant);
  const filters = drives.velocity_filter.map((cutoff) => Math.exp(-cutoff * period));
  const forces = drives.kp.map(() => [0, 0]);
  const [commands, passed] = [[], [Array.from({ length: substeps + 1 }, () => new Float64Array(2 * m))]];
  const before = new Float64Array(m);
  const estimate = new Float64Array(m);
  const positions = drives.kp.map(() => []);
  const time = [];
  for (let tick = 0; tick <= ticks; tick++) {
    const now = passed.at(-1)[substeps];
    const seen = drives.kp.map((_, i) => (sensed[i] ? late(passed, sensed[i], i, m, step) : [now[i], now[m + i]]));
    const command = seen.map(([q, v], i) => {
      estimate[i] = filters[i] * estimate[i] + ((1 - filters[i]) * (q - before[i])) / period;
      before[i] = q;
      return drives.kp[i] * ((i === joint ? 1 : 0) - q) - drives.kd[i] * (differenced ? estimate[i] : v);
    });
    commands.push(command);
    time.push(tick * period);
    positions.forEach((all, i) => all.push(now[i]));
    if (!(Math.max(...now.subarray(0, m).map(Math.abs)) < FAR)) break;
    const means = actuators.map((one, i) => driven(one, forces[i], commands, tick, i));
    const through = [now];
    for (let j = 0; j < substeps; j++) {
      own.go(means.map((each) => each[j]));
      through.push(own.outputs());
    }
    passed.push(through);
    if (passed.length > 2 + Math.max(...sensed.map((one) => one?.whole ?? 0))) passed.shift();
    if (tick % PAUSE === 0) yield;
  }
  return { time, positions };
}

/** The mean forces of a joint over the physics steps of a period; its state goes on. */
function driven({ whole, rows, means }, state, commands, tick, i) {
  const at = (k) => (k < 0 ? 0 : commands[k][i]);
  const from = [...state, at(tick - whole - 1), at(tick - whole)];
  const sum = (row) => row[0] * from[0] + row[1] * from[1] + row[2] * from[2] + row[3] * from[3];
  [state[0], state[1]] = rows.map(sum);
  return means.map(sum);
}

/** Position and velocity of a joint as they were: [q, v], between two physics steps. */
function late(passed, { whole, index, s }, i, m, step) {
  // Nothing has moved before the first period.
  const through = passed[passed.length - 1 - whole];
  if (!through) return [0, 0];
  const [a, b] = [through[index], through[index + 1]];
  const rise = s * s * (3 - 2 * s);
  const bend = step * s * (1 - s) * ((1 - s) * a[m + i] - s * b[m + i]);
  return [(1 - rise) * a[i] + rise * b[i] + bend, (1 - s) * a[m + i] + s * b[m + i]];
}

/** The plant over physics steps: `go(forces)`, and `outputs()`, positions and then velocities. */
function mechanics({ triangular, inputs, outputs }) {
  const [n, m] = [inputs.rows, inputs.columns];
  const [re, im] = [new Float64Array(n), new Float64Array(n)];
  function go(forces) {
    // Row by row from the top: a row takes only what is below it, which is still of before.
    for (let i = 0; i < n; i++) {
      let [x, y] = [0, 0];
      for (let j = i, at = i * (n + 1); j < n; j++, at++) {
        x += triangular.re[at] * re[j] - triangular.im[at] * im[j];
        y += triangular.re[at] * im[j] + triangular.im[at] * re[j];
      }
      for (let k = 0, at = i * m; k < m; k++, at++) {
        x += inputs.re[at] * forces[k];
        y += inputs.im[at] * forces[k];
      }
      [re[i], im[i]] = [x, y];
    }
  }
  const found = () =>
    Float64Array.from({ length: 2 * m }, (_, i) => {
      let x = 0;
      for (let j = 0, at = i * n; j < n; j++, at++) x += outputs.re[at] * re[j] - outputs.im[at] * im[j];
      return x;
    });
  return { go, outputs: found };
}

// A robot's actuators and the instants at which its joints are measured, over a control period.

import { transition } from "./transition.js";

// As in Python, a delay this little below a whole number of periods is that number.
const SNAP = 64 * 2 ** -52;
// A measurement at the end of a physics step belongs to it.
const EARLY = 1e-4;

/** Whole periods and the rest [s] of a delay. */
function split(delay, period) {
  const ratio = delay / period;
  const whole = Math.floor(ratio + SNAP * (1 + ratio));
  return [whole, Math.max(delay - whole * period, 0)];
}

/**
 * The actuator of a joint over a control period: `rows`, its state (f, f'/wn) at the end, and `means`,
 * the mean force of every physics step, each of the state at the start and of the older and the newer
 * of two held commands; these are `whole` periods late.
 */
export function held({ wn, zeta, delay }, period, substeps) {
  const step = period / substeps;
  const [whole, switched] = split(delay, period);
  const joint = { mass: 1, wn, zeta, joint_damping: 0, joint_stiffness: 0 };
  const part = (time) => {
    // The speed of a mass of 1 is the impulse.
    const { phi, gamma } = transition(time, joint);
    const state = (x) => [2, 3].map((i) => phi[i][2] * x[0] + phi[i][3] * x[1]);
    return { state, impulse: phi[1].slice(2), held: [gamma[2], gamma[3]], moved: gamma[1] };
  };
  const whole_step = part(step);
  // State (f, f'/wn) and impulse as rows of what they are of: state at the tick, older, newer.
  let rows = [
    [1, 0, 0, 0],
    [0, 1, 0, 0],
  ];
  const means = [];
  const go = (piece, input) => {
    const impulse = [0, 1, 2, 3].map(
      (k) =>
        piece.impulse[0] * rows[0][k] + piece.impulse[1] * rows[1][k] + (k === input) * piece.moved,
    );
    const columns = [0, 1, 2, 3].map((k) => piece.state([rows[0][k], rows[1][k]]));
    rows = [0, 1].map((i) => columns.map((c, k) => c[i] + (k === input) * piece.held[i]));
    return impulse;
  };
  for (let j = 0; j < substeps; j++) {
    const older = Math.min(Math.max(switched - j * step, 0), step);
    let impulse = [0, 0, 0, 0];
    const pieces = older === 0 || older === step ? [] : [part(older), part(step - older)];
    if (!pieces.length) impulse = go(whole_step, older > 0 ? 2 : 3);
    else [2, 3].forEach((input, i) => go(pieces[i], input).forEach((x, k) => (impulse[k] += x)));
    means.push(impulse.map((x) => x / step));
  }
  return { whole, rows, means };
}

/**
 * The mean force of every physics step of a period per held command: of (zr, zi), [re, im] of
 * `substeps` values.
 */
function servo(own, period, substeps) {
  const { whole, rows, means } = held(own, period, substeps);
  const [[a, b, go0, gn0], [c, d, go1, gn1]] = rows;
  return (zr, zi) => {
    const size = zr * zr + zi * zi;
    const [ir, ii] = [zr / size, -zi / size];
    // (z - Phi) y = older / z + newer, by Cramer's rule
    const [r0, r1] = [
      [gn0 + go0 * ir, go0 * ii],
      [gn1 + go1 * ir, go1 * ii],
    ];
    const det = times([zr - a, zi], [zr - d, zi]);
    det[0] -= b * c;
    const y0 = quotient(plus(times([zr - d, zi], r0), [b * r1[0], b * r1[1]]), det);
    const y1 = quotient(plus(times([zr - a, zi], r1), [c * r0[0], c * r0[1]]), det);
    const late = power([ir, ii], whole);
    return means.map(([m0, m1, older, newer]) =>
      times(late, [
        m0 * y0[0] + m1 * y1[0] + older * ir + newer,
        m0 * y0[1] + m1 * y1[1] + older * ii,
      ]),
    );
  };
}

export const times = ([a, b], [c, d]) => [a * c - b * d, a * d + b * c];
const plus = ([a, b], [c, d]) => [a + c, b + d];
export const quotient = ([a, b], [c, d]) => {
  const size = c * c + d * d;
  return [(a * c + b * d) / size, (b * c - a * d) / size];
};

export function power([x, y], n) {
  const size = Math.hypot(x, y) ** n;
  const angle = n * Math.atan2(y, x);
  return [size * Math.cos(angle), size * Math.sin(angle)];
}

/** Where in a period, and how, a joint is measured: {whole, step, s}, null without delay. */
export function instant(delay, period, step, substeps) {
  if (!(delay > 0)) return null;
  const [whole, rest] = split(delay, period);
  const at = period - rest;
  const index = Math.min(Math.max(Math.ceil(at / step - EARLY) - 1, 0), substeps - 1);
  return { whole, index, s: (at - index * step) / step };
}

/** The actuator of joint i, with the delays on its way. */
export const actuatorOf = (drives, i) => ({
  wn: drives.wn[i],
  zeta: drives.zeta[i],
  delay: drives.delay[i] + drives.output_delay[i],
});

/** The forces of all joints, computed once for joints that are driven alike: [joint][step]. */
export function servos(drives, m, period, substeps) {
  const kinds = new Map();
  const which = Array.from({ length: m }, (_, i) => {
    const own = actuatorOf(drives, i);
    const key = `${own.wn} ${own.zeta} ${own.delay}`;
    if (!kinds.has(key)) kinds.set(key, servo(own, period, substeps));
    return key;
  });
  return (zr, zi) => {
    const found = new Map([...kinds].map(([key, one]) => [key, one(zr, zi)]));
    return which.map((key) => found.get(key));
  };
}

// All margins of a robot at a point: of all joints at once, and of each with the others closed.

import { crossing } from "./margins.js";
import { eigenvalues, largestSingularValue, shifted } from "./matrices.js";
import * as robot from "./robot_loop.js";
import { highest } from "./summits.js";

const TURN = 2 * Math.PI;
// Factors below it are rounding.
const NO_FACTOR = 1e-12;
const STARTS = 24;
const ATTEMPTS = 6;
// Places around a root of the closed loop, in widths.
const PLACES = [-4, -2, -1, -0.5, 0, 0.5, 1, 2, 4];
// Of the lowest angle of the grid: as good as 0.
const AT_REST = 0.003;
// A root is real whose imaginary part is below this share of its real one.
const REAL = 1e-9;
// S, T = I - S and the disk margin's S - I/2, as c I + d S.
const KINDS = [
  [0, 1],
  [1, -1],
  [-0.5, 1],
];

/** S of a point of the grid, and its largest singular values, where they are not there yet. */
export function withSensitivity(point) {
  if (point.peaks?.length === KINDS.length) return;
  point.S = robot.sensitivityOf(point.L);
  point.peaks = KINDS.map(([c, d]) => largestSingularValue(shifted(point.S, c, d)));
}

/** The grid with S. */
export function withSensitivities(loop) {
  loop.points.forEach(withSensitivity);
  return loop.points;
}

/** The frequency of a peak [rad/s]: 0 at the lowest angle that is looked at. */
export const frequencyOf = ({ points, open }, { t }) => (t <= 2 * points[0].t ? 0 : t / open.period);

/** Ms, Mt and the disk margin of changes that may mix the joints, with frequencies [rad/s]; in steps. */
export function* peaks(loop) {
  const points = withSensitivities(loop);
  const found = [];
  for (const [which, [c, d]] of KINDS.entries()) {
    const exact = (t) => largestSingularValue(shifted(robot.sensitivityOf(loop.at(t)), c, d));
    found.push(yield* highest(points, (point) => point.peaks[which], exact));
  }
  const [S, T, disk] = found;
  return {
    sensitivity_peak: S.value,
    sensitivity_peak_frequency: frequencyOf(loop, S),
    complementary_peak: T.value,
    complementary_peak_frequency: frequencyOf(loop, T),
    modulus_margin: 1 / S.value,
    unscaled_disk_margin: 1 / disk.value,
  };
}

/** The margins of joint i while all others are closed, from S_ii; called as Python calls them. In steps. */
export function* ofJoint(loop, i) {
  const points = withSensitivities(loop);
  const { period, joints } = loop.open;
  const place = i * (joints + 1);
  const own = (S) => ({ re: S.re[place], im: S.im[place] });
  const cached = new Map();
  const at = (t) => {
    if (!cached.has(t)) cached.set(t, own(robot.sensitivityOf(loop.at(t))));
    return cached.get(t);
  };
  const sizes = [
    ({ re, im }) => Math.hypot(re, im),
    ({ re, im }) => Math.hypot(1 - re, im),
    ({ re, im }) => Math.hypot(re - 0.5, im),
  ];
  const summits = [];
  for (const size of sizes) {
    summits.push(
      yield* highest(
        points,
        (point) => size(own(point.S)),
        (t) => size(at(t)),
      ),
    );
  }
  const [S, T, disk] = summits;
  const passes = (curve) => {
    const found = [];
    for (let k = 1; k < points.length; k++) {
      if (curve(own(points[k - 1].S)) > 0 === curve(own(points[k].S)) > 0) continue;
      // The grid is a little outside the circle: on it the passage may be beside the next point.
      const around = [1, 2].map((wide) =>
        [k - wide, k - 1 + wide].map((i) => points[Math.min(Math.max(i, 0), points.length - 1)].t),
      );
      const ends = around.find(([a, b]) => curve(at(a)) > 0 !== curve(at(b)) > 0);
      if (ends) found.push(crossing((t) => curve(at(t)), ...ends));
    }
    return found;
  };
  const critical = passes((s) => s.im).concat([points[0].t, Math.PI]).map((t) => {
    const { re } = at(t);
    return { t, factor: re < 0 || re > 1 ? re / (re - 1) : NaN };
  });
  const up = critical.filter(({ factor }) => factor > 1).sort((a, b) => a.factor - b.factor)[0];
  const down = critical.map(({ factor }) => factor).filter((factor) => factor < 1 && factor > NO_FACTOR);
  const turned = passes((s) => s.re - 0.5).map((t) => {
    const { re, im } = at(t);
    // of (S - 1) / S
    return { t, phase: Math.atan2(im, re * re + im * im - re) };
  });
  const nearest = turned.sort((a, b) => Math.abs(a.phase) - Math.abs(b.phase))[0];
  const delays = turned.map(({ t, phase }) => ((phase < 0 ? phase + TURN : phase) / t) * period);
  return {
    gain_margin: up ? up.factor : Infinity,
    gain_reduction_margin: Math.max(0, ...down),
    phase_crossover: up ? up.t / period : Infinity,
    phase_margin: nearest ? nearest.phase : Infinity,
    gain_crossover: nearest ? nearest.t / period : Infinity,
    delay_margin: Math.min(Infinity, ...delays),
    sensitivity_peak: S.value,
    sensitivity_peak_frequency: S.t / period,
    complementary_peak: T.value,
    complementary_peak_frequency: T.t / period,
    disk_margin: 1 / disk.value,
  };
}

/**
 * Roots of the closed loop near the circle, the fastest first: {re, im} of ln z / T [1/s], z in the
 * upper half plane, by Newton's method for an eigenvalue -1 of L.
 */
function* nearbyRoots(loop) {
  const { period } = loop.open;
  const { log } = loop.known;
  const starts = [];
  for (let k = 1; k + 1 < loop.points.length; k++) {
    const [a, b, c] = [k - 1, k, k + 1].map((i) => loop.points[i]);
    const after = robot.matched(b, c);
    b.roots.forEach((value, i) => {
      const [x, y] = [b.before[i], after[i]];
      const speed = Math.hypot(y.re - x.re, y.im - x.im) / (c.t - a.t);
      const near = ({ re, im }) => Math.hypot(1 + re, im);
      if (near(value) > near(x) || near(value) > near(y)) return;
      starts.push({ s: { re: log, im: b.t }, value, apart: near(value) / speed });
    });
  }
  starts.sort((a, b) => a.apart - b.apart);
  const real = [1e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1].flatMap((x) => [log + x, log - x]);
  const still = real.map((re) => ({ s: { re, im: 0 }, value: null }));
  const found = [];
  for (const { s, value } of [...starts.slice(0, STARTS), ...still]) {
    const root = newton(loop, s, value);
    if (root) found.push({ re: root.re / period, im: Math.abs(root.im) / period });
    yield;
  }
  found.sort((a, b) => b.re - a.re);
  // Legs that are alike have roots so near to each other that one start finds only one of them.
  if (found.length) {
    const first = { re: found[0].re * period, im: found[0].im * period };
    const size = Math.exp(first.re);
    const L = loop.beyond(size * Math.cos(first.im), size * Math.sin(first.im));
    for (const value of eigenvalues(L).filter(({ re, im }) => Math.hypot(re + 1, im) < 0.05)) {
      const root = newton(loop, first, value);
      if (root) found.push({ re: root.re / period, im: Math.abs(root.im) / period });
      yield;
    }
  }
  return found.sort((a, b) => b.re - a.re);
}

function newton(loop, start, value) {
  const eigenvalue = (s, near) => {
    const size = Math.exp(s.re);
    const L = loop.beyond(size * Math.cos(s.im), size * Math.sin(s.im));
    const goal = near ?? { re: -1, im: 0 };
    const far = (one) => Math.hypot(one.re - goal.re, one.im - goal.im);
    return eigenvalues(L).reduce((a, b) => (far(b) < far(a) ? b : a));
  };
  let s = start;
  let own = eigenvalue(s, value);
  for (let i = 0; i < 25; i++) {
    const h = 1e-6 * Math.max(Math.hypot(s.re, s.im), 1e-3);
    const there = eigenvalue({ re: s.re + h, im: s.im }, own);
    const [dr, di] = [(there.re - own.re) / h, (there.im - own.im) / h];
    const size = dr * dr + di * di;
    const [fr, fi] = [own.re + 1, own.im];
    const step = { re: (fr * dr + fi * di) / size, im: (fi * dr - fr * di) / size };
    const far = Math.hypot(step.re, step.im);
    const most = 0.3 * Math.max(Math.hypot(s.re, s.im), 1e-3);
    const share = far > most ? most / far : 1;
    s = { re: s.re - share * step.re, im: s.im - share * step.im };
    if (!Number.isFinite(s.re) || Math.abs(s.re) > 3 || s.im > 3.2) return null;
    own = eigenvalue(s, i === 0 ? null : own);
    if (far < 1e-12 * Math.max(Math.hypot(s.re, s.im), 1e-4)) {
      return Math.hypot(own.re + 1, own.im) < 1e-6 ? s : null;
    }
  }
  return null;
}

/** The frequency of a root [rad/s]: 0 of a real one, which Newton's method leaves at rounding. */
const turning = ({ re, im }) => (im > REAL * Math.abs(re) ? im : 0);

/** A root of the loop over a period as {re, im} [1/s]. */
const rateOf = ({ re, im }, period) => ({
  re: Math.log(Math.hypot(re, im)) / period,
  im: Math.abs(Math.atan2(im, re)) / period,
});

/**
 * The growth rate {rate [1/s], frequency [rad/s]}, and whether the robot shakes or topples; the
 * rate is null where counting does not confirm that no root is further right. In steps.
 */
export function* growth(loop) {
  const { period, hidden } = loop.open;
  const moving = ({ re, im }) => Math.hypot(re - 1, im) > robot.OUTSIDE && Math.hypot(re, im) > 0;
  const own = hidden.filter(moving).map((root) => rateOf(root, period));
  // Without any gains the roots of the open loop are all.
  if ([...loop.kp, ...loop.kd].every((gain) => gain === 0)) {
    own.push(...loop.open.poles.filter(moving).map((root) => rateOf(root, period)));
  }
  const unstable = loop.count(1);
  let [found, sure, from] = [own, false, loop];
  const beyond = (rate) => robot.rootsBeyond(loop, rate * period);
  let [low, high] = [0, Infinity];
  for (let i = 0; i < ATTEMPTS && !sure; i++) {
    found = [...(yield* nearbyRoots(from)), ...found].sort((a, b) => b.re - a.re);
    const first = found.length ? found[0].re : -Infinity;
    const further = first + Math.max(1e-6 * Math.abs(first), 1e-3);
    sure = found.length > 0 && (yield* beyond(further)) === 0;
    if (sure || i + 1 === ATTEMPTS) break;
    // One is further right: it is looked for from a circle that is nearer to it.
    if (high === Infinity) {
      low = Math.max(first, unstable > 0 ? 0 : -1 / period);
      high = Math.max(2 * low, 0.01 / period);
      for (; (yield* beyond(high)) > 0; high *= 2) low = high;
    }
    const middle = 0.5 * (low + high);
    if ((yield* beyond(middle)) > 0) low = middle;
    else high = middle;
    const known = yield* robot.responding(loop.open, false, 0.5 * (low + high) * period);
    from = yield* robot.closing(known, loop.kp, loop.kd);
  }
  const growing = found.filter(({ re }) => re * period > robot.OUTSIDE);
  return {
    unstable_roots: unstable,
    stable: unstable === 0,
    shakes: growing.some(({ re, im }) => im > re),
    topples: growing.some(({ re, im }) => im <= re),
    rate: sure ? found[0].re : null,
    frequency: sure ? turning(found[0]) : null,
    roots: found,
  };
}

/** Points around the roots that were found, so that no peak and no crossing is missed; in steps. */
export function* sharpen(loop, roots) {
  const { period } = loop.open;
  const more = roots.flatMap(({ re, im }) =>
    PLACES.map((x) => (im + x * Math.max(Math.abs(re), 1e-6 * im)) * period),
  );
  // What is highest at rest is not seen at the lowest angle of the grid exactly.
  const lowest = AT_REST * loop.points[0].t;
  const all = [lowest, ...more.filter((t) => t > lowest)];
  yield* loop.refine([...new Set(all.map((t) => Number(t.toPrecision(9))))]);
}

/** How the joints move where more delay makes the loop marginal. */
export function lateShape({ open, kp, kd }, { delay, t }, inertias) {
  const late = open.later(delay > 0 ? delay : 0);
  const at = robot.loopOf(late.respond(Math.cos(t), Math.sin(t)), kp, kd);
  return shape(late, at, [Math.cos(t), Math.sin(t)], inertias);
}

/** How they move where a factor on all gains does. */
export function gainShape(loop, { factor, t }, inertias) {
  const at = shifted(loop.at(t), 0, factor);
  return shape(loop.open, at, [Math.cos(t), Math.sin(t)], inertias);
}

/** How they move in a growing motion, {re, im} [1/s]. */
export function growingShape(loop, { re, im }, inertias) {
  const { period } = loop.open;
  const size = Math.exp(re * period);
  const z = [size * Math.cos(im * period), size * Math.sin(im * period)];
  return shape(loop.open, loop.beyond(...z), z, inertias);
}

/**
 * The joints in the motion z with L there: {amplitude, of the largest, phase [rad], share} of each;
 * `share` of the energy I |v|^2.
 */
function shape(open, L, [zr, zi], inertias) {
  const P = open.respond(zr, zi);
  // The command that returns as itself, by inverse iteration with I + L.
  const inverse = robot.sensitivityOf(L);
  let u = inertias.map((_, i) => [1 + 0.1 * Math.cos(7 * i), 0.1 * Math.sin(3 * i)]);
  for (let i = 0; i < 12; i++) {
    u = applied(inverse, u);
    const size = Math.hypot(...u.flat());
    u = u.map(([a, b]) => [a / size, b / size]);
  }
  const [moved, speed] = [applied(P.moved, u), applied(P.speed, u)];
  const sizes = moved.map(([a, b]) => Math.hypot(a, b));
  const largest = Math.max(...sizes);
  const [x, y] = moved[sizes.indexOf(largest)];
  const energy = speed.map(([a, b], i) => inertias[i] * (a * a + b * b));
  const total = energy.reduce((a, b) => a + b, 0);
  return moved.map(([a, b], i) => ({
    amplitude: sizes[i] / largest,
    phase: Math.atan2(b * x - a * y, a * x + b * y),
    share: energy[i] / total,
  }));
}

const applied = (M, x) =>
  x.map((_, i) =>
    x.reduce(
      ([re, im], [a, b], j) => {
        const at = i * M.n + j;
        return [re + M.re[at] * a - M.im[at] * b, im + M.re[at] * b + M.im[at] * a];
      },
      [0, 0],
    ),
  );

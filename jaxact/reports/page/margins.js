// All stability margins of a loop, exact: crossovers and peaks are found on the grid and refined.

import { openLoop } from "./frequencies.js";
import { unstableRoots } from "./roots.js";
import { sampledDelayLeft } from "./sampled_delay.js";

const TURN = 2 * Math.PI;
// Factors below it are rounding: at rest the loop gain of a free joint is infinite.
const NO_FACTOR = 1e-12;

/** Where f changes sign between low and high: regula falsi, halving where it would stall. */
export function crossing(f, low, high) {
  let [a, b, fa, fb] = [low, high, f(low), f(high)];
  for (let i = 0; i < 200 && b - a > 4e-16 * b; i++) {
    let x = i % 3 === 2 ? 0.5 * (a + b) : (a * fb - b * fa) / (fb - fa);
    if (!(x > a && x < b)) x = 0.5 * (a + b);
    if (x === a || x === b) break;
    const fx = f(x);
    if (fx === 0) return x;
    if (fx > 0 === fa > 0) [a, fa] = [x, fx];
    else [b, fb] = [x, fx];
  }
  return 0.5 * (a + b);
}

/** ln |L|, arg(-L) as the loop is passed, and the slopes of ln |S|, ln |T|, ln |S - 1/2| by w. */
const logGain = ({ re, im }) => 0.5 * Math.log(re * re + im * im);
const gainSlope = ({ re, im, dre, dim }) => (re * dre + im * dim) / (re * re + im * im);
const quotient = (dre, dim, re, im) => (dre * re + dim * im) / (re * re + im * im);
const SLOPES = [
  ({ re, im, dre, dim }) => -quotient(dre, dim, 1 + re, im),
  ({ re, im, dre, dim }) => quotient(dre, dim, re + re * re - im * im, im + 2 * re * im),
  ({ re, im, dre, dim }) => -quotient(dre, dim, 1 - re * re + im * im, -2 * re * im),
];
const HEIGHTS = [
  ({ re, im }) => 1 / Math.hypot(1 + re, im),
  ({ re, im }) => Math.hypot(re, im) / Math.hypot(1 + re, im),
  ({ re, im }) => (0.5 * Math.hypot(1 - re, im)) / Math.hypot(1 + re, im),
];

/**
 * Margins of one loop, called as jaxact calls them; null where the loop is unstable.
 *
 * Frequencies [rad/s], `phase_margin` [rad], `delay_margin` [s], Infinity where there is none.
 */
export function margins(loop, cached, kp, kd) {
  const unstable = unstableRoots(loop, cached, kp, kd);
  const at = (w) => openLoop(loop, kp, kd, w);
  const w = withExtremes(cached.w, at);
  const L = w.map(at);
  const gain = crossovers(w, L, at);
  const factors = criticalFactors(loop, kp, w, L, at);
  const peaks = highest(loop, kp, w, L, at, [...gain, ...factors.map((one) => one.w)]);
  return {
    stable: unstable === 0,
    unstable_roots: unstable,
    ...read(loop, gain, factors, peaks, at, (angles) =>
      unstable === 0 ? delayLeft(loop, kp, kd, w, angles) : NaN,
    ),
  };
}

/** The delay [s] that is left: of the phase at a gain crossover, if no control period matters. */
function delayLeft(loop, kp, kd, grid, angles) {
  if (loop.sampled) {
    const gain = angles.map((one) => one.w);
    return sampledDelayLeft(loop, kp, kd, grid, gain, { crossing, crossovers });
  }
  const left = angles.map(({ w, angle }) => (angle < 0 ? angle + TURN : angle) / w);
  return Math.min(Infinity, ...left);
}

function read(loop, gain, factors, peaks, at, delay) {
  const angles = gain.map((w) => {
    const { re, im } = at(w);
    return { w, angle: Math.atan2(-im, -re) };
  });
  const nearest = smallest(angles, ({ angle }) => Math.abs(angle));
  const up = smallest(
    factors.filter(({ factor }) => factor > 1),
    ({ factor }) => factor,
  );
  const down = factors
    .map(({ factor }) => factor)
    .filter((factor) => factor < 1 && factor > NO_FACTOR);
  const [Ms, Mt, disk] = peaks;
  return {
    gain_margin: up ? up.factor : Infinity,
    gain_reduction_margin: Math.max(0, ...down),
    phase_crossover: up ? up.w : Infinity,
    phase_margin: nearest ? nearest.angle : Infinity,
    gain_crossover: nearest ? nearest.w : Infinity,
    delay_margin: delay(angles),
    sensitivity_peak: Ms.height,
    sensitivity_peak_frequency: Ms.w,
    complementary_peak: Mt.height,
    complementary_peak_frequency: Mt.w,
    modulus_margin: 1 / Ms.height,
    disk_margin: 1 / disk.height,
  };
}

const smallest = (items, key) =>
  items.reduce((best, one) => (best === null || key(one) < key(best) ? one : best), null);

/** The grid with the extremes of |L| in it, so that |L| is monotone between neighbours. */
function withExtremes(grid, at) {
  const slope = (w) => gainSlope(at(w));
  const found = [];
  let before = slope(grid[0]);
  for (let i = 1; i < grid.length; i++) {
    const here = slope(grid[i]);
    if (before > 0 !== here > 0) found.push(crossing(slope, grid[i - 1], grid[i]));
    before = here;
  }
  // At the resonance of an undamped joint there is no largest |L|.
  const finite = found.filter((w) => Number.isFinite(logGain(at(w))));
  return finite.length ? [...grid, ...finite].sort((a, b) => a - b) : [...grid];
}

/** All frequencies with |L| = 1. */
function crossovers(w, L, at) {
  const found = [];
  for (let i = 1; i < w.length; i++) {
    if (logGain(L[i - 1]) > 0 !== logGain(L[i]) > 0) {
      found.push(crossing((x) => logGain(at(x)), w[i - 1], w[i]));
    }
  }
  return found;
}

/** Where L passes the negative real axis, and the factor on the gains that makes that critical. */
function criticalFactors(loop, kp, w, L, at) {
  const found = [];
  for (let i = 1; i < w.length; i++) {
    const [a, b] = [L[i - 1], L[i]];
    const passes = a.im > 0 !== b.im > 0;
    if (passes && a.re * Math.abs(b.im) + b.re * Math.abs(a.im) < 0) {
      const there = crossing((x) => at(x).im, w[i - 1], w[i]);
      found.push({ w: there, factor: 1 / Math.hypot(at(there).re, at(there).im) });
    }
  }
  if (loop.sampled && at(loop.end).re < 0)
    found.push({ w: loop.end, factor: -1 / at(loop.end).re });
  // Where stiffness kp + k passes zero, a real root passes the origin.
  const k = loop.parameters.joint_stiffness;
  if (kp * k < 0) found.push({ w: 0, factor: -k / kp });
  return found;
}

/** Largest |S|, |T| and |S - 1/2| with their frequencies. */
function highest(loop, kp, grid, L, at, crossings) {
  const points = grid.map((w, i) => ({ w, L: L[i] }));
  points.push(...crossings.filter((w) => w > 0).map((w) => ({ w, L: at(w) })));
  points.sort((a, b) => a.w - b.w);
  const k = loop.parameters.joint_stiffness;
  const still = k === 0 ? [0, 1, 0.5] : [k, kp, 0.5 * (k - kp)].map((x) => Math.abs(x / (kp + k)));
  return HEIGHTS.map((height, which) => {
    const values = points.map((one) => height(one.L));
    const tops = values
      .map((value, i) => ({ value, i }))
      .filter(({ value, i }) => !(values[i - 1] > value) && !(values[i + 1] > value));
    const refined = tops.map(({ i }) => {
      const slope = (w) => SLOPES[which](at(w));
      const [low, high] = [
        points[Math.max(i - 1, 0)].w,
        points[Math.min(i + 1, points.length - 1)].w,
      ];
      const w = slope(low) > 0 && slope(high) < 0 ? crossing(slope, low, high) : points[i].w;
      return { w, height: height(at(w)) };
    });
    // At the resonance of an undamped joint there is no number.
    const numbers = refined.filter((one) => !Number.isNaN(one.height));
    const best = numbers.reduce((a, b) => (a.height > b.height ? a : b));
    return limited(loop, which, best, still[which]);
  });
}

/** No peak is lower than what it tends to at rest, or, in continuous time, at high frequency. */
function limited(loop, which, best, still) {
  const far = loop.sampled || which === 1 ? 0 : [1, 0, 0.5][which];
  const floor = Math.max(still, far);
  if (best.height > floor) return best;
  return {
    w: still >= far ? (which !== 1 && still === far ? Infinity : 0) : Infinity,
    height: floor,
  };
}

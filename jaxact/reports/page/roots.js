// How many closed-loop roots lie right of a line, by the argument principle, and the rightmost one.
//
// Delta turns by n pi/2 - Z pi as s runs from sigma to sigma + j infinity, where Z counts the roots
// right of sigma and n is the degree of A; of the sampled loop, as a function of 1/z, by -Z pi from
// sigma to sigma + j pi/T.

const FINE = 1.0;
const DEEPEST = 40;
const MOST_BEYOND = 4000;
const SETTLED = 0.5;
// A stiffness left that is rounding, and how far left of the axis a root on it is counted.
const NO_STIFFNESS = 1e-14;
const BESIDE = 1e-9;

/** Delta and Delta' at sigma + j w, and |Delta - A| / |A|. */
export function characteristic(loop, kp, kd, sigma, w) {
  const { A, B, C } = loop.parts(sigma, w);
  return {
    re: A.re + kp * B.re + kd * C.re,
    im: A.im + kp * B.im + kd * C.im,
    dre: A.dre + kp * B.dre + kd * C.dre,
    dim: A.dim + kp * B.dim + kd * C.dim,
    share: Math.hypot(kp * B.re + kd * C.re, kp * B.im + kd * C.im) / Math.hypot(A.re, A.im),
  };
}

/** The nearest whole number, never -0. */
const whole = (x) => Math.round(x) + 0;

/** The angle from a to b, in (-pi, pi]. */
const angle = (a, b) => Math.atan2(a.re * b.im - a.im * b.re, a.re * b.re + a.im * b.im);

/** The angle by which Delta turns between two frequencies, halved until no part turns far. */
function turned(at, low, first, high, last, depth = 0) {
  const whole = angle(first, last);
  if (Math.abs(whole) < FINE || depth >= DEEPEST) return whole;
  const middle = 0.5 * (low + high);
  const between = at(middle);
  return (
    turned(at, low, first, middle, between, depth + 1) +
    turned(at, middle, between, high, last, depth + 1)
  );
}

/** Number of roots with real part above sigma; `grid` of `frequencyGrid`. */
export function rootsRightOf(loop, kp, kd, sigma, grid) {
  const at = (w) => characteristic(loop, kp, kd, sigma, w);
  let w = 0;
  let value = at(0);
  let total = 0;
  const go = (next) => {
    const there = at(next);
    total += turned(at, w, value, next, there);
    [w, value] = [next, there];
  };
  for (const next of grid) go(next);
  if (loop.sampled) return whole(-total / Math.PI);
  // Left of the axis the delay amplifies the command: on, until the rest of Delta is A's.
  const step = loop.lag > 0 ? 0.5 / loop.lag : Infinity;
  for (let i = 0; i < MOST_BEYOND && value.share > SETTLED; i++) go(w + Math.min(0.05 * w, step));
  return whole(loop.degree / 2 - (total + left(loop, sigma, w, value)) / Math.PI);
}

/** The angle of Delta from here to s = j infinity, near A, whose factors turn on towards j^n. */
function left(loop, sigma, w, value) {
  const { A } = loop.parts(sigma, w);
  const quarter = (loop.degree * Math.PI) / 2;
  // What A has still to turn is less than half a turn beyond all corners.
  const ahead = quarter - Math.atan2(A.im, A.re);
  const rest = ahead - 2 * Math.PI * Math.round(ahead / (2 * Math.PI));
  return rest + angle(value, A);
}

/**
 * Number of unstable roots at given gains from the cached A, B and C alone; one at rest is, where
 * nothing holds the joint as its own stiffness takes all of kp away.
 *
 * As `rootsRightOf` at 0; small turns are told by the signs of Delta: the whole turn is the angle at
 * the end and a full turn for every passage of the negative real axis.
 */
export function unstableRoots(loop, cached, kp, kd) {
  const { w, ar, ai, br, bi, cr, ci } = cached;
  const { mass, joint_stiffness: k } = loop.parameters;
  if (Math.abs(kp + k) <= NO_STIFFNESS * Math.abs(k)) {
    return rootsRightOf(loop, kp, kd, -BESIDE * Math.sqrt(Math.abs(k) / mass), w);
  }
  const at = (frequency) => characteristic(loop, kp, kd, 0, frequency);
  const origin = at(0);
  let [re, im] = [origin.re, origin.im];
  let turns = 0;
  for (let i = 0; i < w.length; i++) {
    const nextRe = ar[i] + kp * br[i] + kd * cr[i];
    const nextIm = ai[i] + kp * bi[i] + kd * ci[i];
    const across = re * nextIm - im * nextRe;
    const along = re * nextRe + im * nextIm;
    if (Math.abs(across) < along) {
      if (re < 0 && im >= 0 !== nextIm >= 0) turns += im >= 0 ? 1 : -1;
    } else {
      const turn = turned(at, i ? w[i - 1] : 0, { re, im }, w[i], { re: nextRe, im: nextIm });
      turns += Math.round((turn - Math.atan2(nextIm, nextRe) + Math.atan2(im, re)) / (2 * Math.PI));
    }
    [re, im] = [nextRe, nextIm];
  }
  const total = 2 * Math.PI * turns + Math.atan2(im, re) - Math.atan2(origin.im, origin.re);
  if (loop.sampled) return whole(-total / Math.PI);
  return whole(loop.degree / 2 - (total + left(loop, 0, w[w.length - 1], { re, im })) / Math.PI);
}

/**
 * The closed-loop root with the largest real part [1/s], {re, im} with im >= 0.
 *
 * A line is moved until the rightmost root lies between it and another; Newton's method started
 * where Delta on the line is nearest to zero finds it, and counting confirms that none is beyond.
 */
export function rightmostRoot(loop, kp, kd, grid) {
  const { mass, joint_stiffness: k } = loop.parameters;
  const count = (sigma) => rootsRightOf(loop, kp, kd, sigma, grid);
  const scale = 0.02 * Math.sqrt((Math.abs(kp) + Math.abs(k)) / mass);
  let [low, high] = [0, 0];
  if (count(0) > 0) for (high = scale; count(high) > 0; high *= 4) low = high;
  else for (low = -scale; count(low) === 0; low *= 2) high = low;
  for (let i = 0; i < 60; i++) {
    const found = nearestRoot(loop, kp, kd, low, high, grid);
    if (found !== null && count(found.re + 1e-7 * Math.hypot(found.re, found.im)) === 0) {
      return found;
    }
    const middle = 0.5 * (low + high);
    if (count(middle) > 0) low = middle;
    else high = middle;
  }
  return { re: 0.5 * (low + high), im: NaN };
}

/** The rightmost of the roots that Newton's method finds from a strip, null if it finds none. */
function nearestRoot(loop, kp, kd, low, high, grid) {
  const sigma = 0.5 * (low + high);
  const at = (w) => characteristic(loop, kp, kd, sigma, w);
  const nearness = ({ re, im, dre, dim }) => Math.hypot(re, im) / Math.hypot(dre, dim);
  const frequencies = [0, ...grid];
  const distance = frequencies.map((w) => nearness(at(w)));
  const minima = frequencies
    .map((w, i) => ({ w, d: distance[i], i }))
    .filter(({ i, d }) => !(distance[i - 1] < d) && !(distance[i + 1] < d))
    .sort((a, b) => a.d - b.d)
    .slice(0, 6);
  const roots = minima
    .map(({ w }) => newton(loop, kp, kd, sigma, w))
    .filter((root) => root !== null && root.re >= low - 1e-9 * Math.abs(low) && root.re <= high);
  return roots.length ? roots.reduce((a, b) => (a.re > b.re ? a : b)) : null;
}

function newton(loop, kp, kd, re, im) {
  for (let i = 0; i < 60; i++) {
    const d = characteristic(loop, kp, kd, re, im);
    const size = d.dre * d.dre + d.dim * d.dim;
    const stepRe = (d.re * d.dre + d.im * d.dim) / size;
    const stepIm = (d.im * d.dre - d.re * d.dim) / size;
    [re, im] = [re - stepRe, im - stepIm];
    if (!Number.isFinite(re) || !Number.isFinite(im)) return null;
    if (Math.hypot(stepRe, stepIm) <= 1e-14 * Math.hypot(re, im)) return { re, im: Math.abs(im) };
  }
  return null;
}

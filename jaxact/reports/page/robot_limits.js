// How far a robot's gains and delay may move until a root crosses the unit circle.
//
// A factor g on all gains is marginal where -1/g is an eigenvalue of L on the circle, a delay of d
// periods where exp(-j w d) l_i(w) = -1; the count of roots on either side confirms each.

import { eigenvalues, shifted } from "./matrices.js";
import { closing, loopOf, OUTSIDE, responding, rootsBeyond } from "./robot_loop.js";
import { marginalPoints } from "./robot_marginal.js";

// Beside a crossing, relative.
const BESIDE = 1e-4;
const FURTHEST = 1e6;
// Crossings so near to each other are looked at together; of delays.
const NEAR = 1e-3;
const TOGETHER = 1e-2;
const MOST_CANDIDATES = 24;
// Where counting has found a change it is within this share, as it looks a little outside the circle.
const COUNTED = 1e-3;
const MOST_STARTS = 6;

/** Where a real function of an eigenvalue passes 0 between points: {t, low, high, value}. */
function crossings({ points }, curve) {
  const found = [];
  for (let k = 1; k < points.length; k++) {
    const [a, b] = [points[k - 1], points[k]];
    b.before.forEach((before, i) => {
      const after = b.roots[i];
      const [x, y] = [curve(before), curve(after)];
      if (x > 0 === y > 0) return;
      const share = x / (x - y);
      const value = {
        re: before.re + share * (after.re - before.re),
        im: before.im + share * (after.im - before.im),
      };
      found.push({ t: a.t + share * (b.t - a.t), low: a.t, high: b.t, value });
    });
  }
  return found;
}

/** The eigenvalue of L on the circle that is nearest to a value. */
export function nearestRoot(loop, t, value) {
  const far = (one) => Math.hypot(one.re - value.re, one.im - value.im);
  return eigenvalues(loop.at(t)).reduce((a, b) => (far(b) < far(a) ? b : a));
}

/** A crossing to rounding, by regula falsi with halving. */
function refined(loop, { low, high, t, value }, curve) {
  let [a, b, x, guess] = [low, high, t, value];
  let [fa, fb] = [curve(nearestRoot(loop, a, guess)), curve(nearestRoot(loop, b, guess))];
  if (fa > 0 === fb > 0) return { t, value, sure: false };
  for (let i = 0; i < 60 && b - a > 1e-14 * b; i++) {
    if (!(x > a && x < b) || i % 4 === 3) x = 0.5 * (a + b);
    guess = nearestRoot(loop, x, guess);
    const fx = curve(guess);
    if (fx > 0 === fa > 0) [a, fa] = [x, fx];
    else [b, fb] = [x, fx];
    x = (a * fb - b * fa) / (fb - fa);
    if (Math.abs(fx) < 1e-14 * (1 + Math.abs(guess.re))) break;
  }
  const found = nearestRoot(loop, x, guess);
  // Among eigenvalues that are almost equal, what looked like a passage may be two of them.
  return { t: x, value: found, sure: Math.abs(curve(found)) < 1e-9 * (1 + Math.abs(found.re)) };
}

/** Factors on all gains at which an eigenvalue of L is -1/g: {factor, t, ...}, rising. */
function factors(loop) {
  const found = crossings(loop, (l) => l.im).filter(({ value }) => value.re < 0);
  const { points } = loop;
  for (const { re, im } of points[points.length - 1].roots) {
    if (Math.abs(im) < 1e-6 * Math.abs(re) && re < 0) {
      found.push({ t: Math.PI, low: Math.PI, high: Math.PI, value: { re, im: 0 } });
    }
  }
  for (const { re, im } of loop.points[0].roots) {
    if (Math.abs(im) < 1e-2 * Math.abs(re) && re < 0) {
      found.push({ t: 0, low: 0, high: 0, value: { re, im: 0 } });
    }
  }
  return found
    .map((one) => ({ ...one, factor: -1 / one.value.re }))
    .filter(({ factor }) => factor > 1 / FURTHEST && factor < FURTHEST);
}

/**
 * Ranges of factors on all gains with the number of roots that are unstable, and of those that
 * swing, if none does at the lowest gains: {low, high, unstable, shaking}, one after the other up to
 * a factor; for a map, not refined.
 */
export function* ranges(loop, most = Infinity) {
  const together = grouped(factors(loop).sort((a, b) => a.factor - b.factor), (one) => Math.log(one.factor));
  let [low, shaking, before] = [0, 0, null];
  for (let i = 0; i <= together.length && low <= most; i++) {
    const first = together[i]?.[0].factor ?? Infinity;
    const middle = low === 0 ? 0.5 * Math.min(first, 2) : Math.sqrt(low * Math.min(first, 4 * low));
    const unstable = loop.count(middle);
    if (before !== null && together[i - 1][0].t > 0) shaking += unstable - before;
    const high = together[i]?.at(-1).factor ?? Infinity;
    yield { low, high, unstable, shaking };
    [low, before] = [high, unstable];
  }
}

/** Crossings in their order that are so near to each other that they are looked at together. */
function grouped(all, place) {
  const found = [];
  for (const one of all) {
    const last = found[found.length - 1];
    if (last && place(one) - place(last[0]) < NEAR * (1 + Math.abs(place(one)))) last.push(one);
    else found.push([one]);
  }
  return found;
}

/**
 * The nearest factor above or below 1 at which the number of unstable roots changes: {factor, t,
 * before, after}, null where there is none; with `swing` where a motion that swings begins to grow.
 * In steps.
 */
export function* gainLimit(loop, up, swing = false) {
  const sign = up ? 1 : -1;
  const ahead = factors(loop)
    .map((one) => ({ ...one, d: sign * Math.log(one.factor) }))
    .filter(({ d }) => d > 0)
    .sort((a, b) => a.d - b.d);
  const together = grouped(ahead, ({ d }) => d);
  const at = (d) => loop.count(Math.exp(sign * d));
  let [before, start] = [loop.count(1), 0];
  for (let i = 0; i < Math.min(together.length, MOST_CANDIDATES); i++) {
    const last = together[i][together[i].length - 1].d;
    const beyond = i + 1 < together.length ? 0.5 * (last + together[i + 1][0].d) : 1.5 * last + 0.1;
    const after = at(beyond);
    yield;
    const counts = swing ? together[i][0].t > 0 && after > before : after !== before;
    if (counts) {
      const found = yield* limited(loop, together[i], sign, at, [start, beyond], before);
      return { ...found, before, after };
    }
    [before, start] = [after, beyond];
  }
  return null;
}

function* limited(loop, candidates, sign, at, [start, beyond], before) {
  const exact = [];
  for (const one of candidates) {
    if (one.t > 0 && one.t < Math.PI) {
      const { t, value, sure } = refined(loop, one, (l) => l.im);
      if (sure && value.re < 0) exact.push({ t, d: sign * Math.log(-1 / value.re) });
      exact.push(...alike(loop, one, sign));
    } else {
      exact.push({ t: one.t, d: sign * Math.log(-1 / nearestRoot(loop, one.t, one.value).re) });
    }
    yield;
  }
  let { t, d } = exact.reduce((a, b) => (b.d < a.d ? b : a), { t: candidates[0].t, d: Infinity });
  const near = Math.max(d, 1e-3);
  // Slow growth shows on a circle a little outside only further beyond.
  const beside = [1, 10, 100].some((x) => at(d + x * BESIDE * near) !== before);
  if (!(d > 0) || !beside || at(d - BESIDE * near) !== before) {
    let [low, high] = [start, beyond];
    while (high - low > 1e-5 * high) {
      const middle = 0.5 * (low + high);
      if (at(middle) === before) low = middle;
      else high = middle;
      yield;
    }
    d = 0.5 * (low + high);
    const counted = exact.filter((one) => Math.abs(one.d - d) < COUNTED * d);
    if (counted.length) ({ t, d } = counted.reduce((a, b) => (b.d < a.d ? b : a)));
  }
  return { factor: Math.exp(sign * d), t };
}

/** Crossings {t, d} of all eigenvalues that are near one, those of legs that are alike among them. */
function alike(loop, { t, factor }, sign) {
  const at = (angle, g) => shifted(loop.at(angle), 0, g);
  const near = (_, g) => g > 0.5 * factor && g < 2 * factor;
  const found = marginalPoints(at, [t, factor], near);
  return found.map(({ x, y }) => ({ t: x, d: sign * Math.log(y) })).filter(({ d }) => d > 0);
}

/**
 * The smallest delay of all commands at which one more motion grows: {delay [s], t}, null if none;
 * the delay is NaN where counting the roots does not confirm it. In steps.
 */
export function* delayLimit(loop) {
  const { open, kp, kd } = loop;
  const { period } = open;
  const guesses = crossings(loop, (l) => l.re * l.re + l.im * l.im - 1)
    .map((one) => {
      const angle = Math.atan2(-one.value.im, -one.value.re);
      return { ...one, delay: (angle < 0 ? angle + 2 * Math.PI : angle) / one.t };
    })
    .sort((a, b) => a.delay - b.delay);
  let [best, done] = [null, -1];
  for (const guess of guesses) {
    if (best && guess.delay > 1.1 * best.delay + 2) break;
    // Joints that are alike cross together: all that are near are looked at from the first.
    if (guess.delay - done < TOGETHER * (1 + done)) continue;
    done = guess.delay;
    for (const found of marginal(loop, guess)) {
      if (!best || found.delay < best.delay) best = found;
    }
    yield;
  }
  if (!best) return null;
  const before = loop.count(1);
  function* first(delays) {
    for (const delay of delays) {
      const later = open.later(delay * period);
      if ((yield* rootsBeyond({ open: later, kp, kd }, OUTSIDE)) > before) return delay;
    }
    return null;
  }
  const beyond = [BESIDE, 10 * BESIDE, 100 * BESIDE].map((x) => best.delay * (1 + x) + x);
  if ((yield* first(beyond)) === null) return { delay: NaN, t: best.t };
  const early = yield* first([0.25, 0.5, 0.75, 1 - BESIDE].map((x) => x * best.delay));
  if (early === null) return { delay: best.delay * period, t: best.t };
  let [low, high] = [0, early];
  while (high - low > 1e-6 * high) {
    const middle = 0.5 * (low + high);
    if ((yield* first([middle])) === null) low = middle;
    else high = middle;
  }
  const found = yield* beside(loop, high);
  return found ? { delay: found.delay * period, t: found.t } : { delay: high * period, t: best.t };
}

/** Delays [periods] and angles near a guess at which an eigenvalue of L is -1. */
function marginal({ open, kp, kd }, { t, delay }) {
  const at = (angle, late) => {
    const { respond } = open.later(late * open.period);
    return loopOf(respond(Math.cos(angle), Math.sin(angle)), kp, kd);
  };
  const near = (_, late) => Math.abs(late - delay) < 2;
  return marginalPoints(at, [t, delay], near).map(({ x, y }) => ({ t: x, delay: y }));
}

/** Where, near a delay [periods] that counting has found, an eigenvalue of L is -1; null if nowhere. */
function* beside({ open, kp, kd }, delay) {
  const known = yield* responding(open.later(delay * open.period), true);
  const { points } = yield* closing(known, kp, kd);
  const apart = ({ roots }) => Math.min(...roots.map(({ re, im }) => Math.hypot(re + 1, im)));
  const lows = points.map((point) => ({ t: point.t, apart: apart(point) }));
  const starts = lows
    .filter(({ apart: own }, i) => !(lows[i - 1]?.apart < own) && !(lows[i + 1]?.apart < own))
    .sort((a, b) => a.apart - b.apart);
  let best = null;
  for (const { t } of starts.slice(0, MOST_STARTS)) {
    for (const found of marginal({ open, kp, kd }, { t, delay })) {
      const far = Math.abs(found.delay - delay);
      if (far < COUNTED * delay && (!best || found.delay < best.delay)) best = found;
    }
    yield;
  }
  return best;
}

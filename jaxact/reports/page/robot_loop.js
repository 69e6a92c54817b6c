// A robot's loop closed: how many roots are outside the unit circle, and where they cross it.
//
//   L = kp Q + kd V,     det(I + g L(z)) = prod (1 + g l_i(z)) over the eigenvalues of L.
//
// As z runs once around the circle, 1 + ... turns by as many times as there are roots of the open
// loop outside it, less those of the closed one. A factor g on all gains is marginal where -1/g is
// an eigenvalue.

import { eigenvalues, inverse, shifted, zeros } from "./matrices.js";

// Where roots are counted: this far outside the circle, as static ones are 1 but for rounding.
export const OUTSIDE = 1.5e-7;
// Places around a root in widths of its resonance.
const FINE = [-4, -2, -1, -0.5, 0, 0.5, 1, 2, 4];
const COARSE = [-1.5, 0, 1.5];
const LARGEST_TURN = 0.9;
const MOST_POINTS = 4000;
// Beside a crossing, relative.
const BESIDE = 1e-4;
const FURTHEST = 1e6;
// Crossings so near to each other are looked at together; of delays, eigenvalues this near to -1.
const NEAR = 1e-3;
const TOGETHER = 1e-2;
const AROUND = 0.5;
const MOST_CANDIDATES = 24;

/** Angles w T in (0, pi], dense around every root of the open loop as seen from a circle. */
export function angles(open, fine, radius = OUTSIDE) {
  const roots = open.poles
    .filter(({ re, im }) => Math.hypot(re, im) > 1e-4)
    .map(({ re, im }) => ({ rate: Math.log(Math.hypot(re, im)), turn: Math.abs(Math.atan2(im, re)) }));
  const corners = roots.map(({ rate, turn }) => Math.hypot(rate, turn));
  const slowest = Math.min(1e-2, ...corners.filter((x) => x > 1e-5));
  const low = Math.max(0.03 * slowest, 1e-6);
  const found = [];
  const number = Math.ceil((fine ? 24 : 9) * Math.log10(Math.PI / low));
  for (let i = 0; i <= number; i++) found.push(low * (Math.PI / low) ** (i / number));
  const lobes = Math.ceil((fine ? 5 : 2) * (open.delays + 2));
  for (let i = 1; i < lobes; i++) found.push((Math.PI * i) / lobes);
  for (const { rate, turn } of roots) {
    const width = Math.max(Math.abs(rate - radius), 1e-9);
    for (const x of fine ? FINE : COARSE) found.push(turn + x * width);
  }
  const apart = fine ? 1e-6 : 1e-3;
  const sorted = found.filter((t) => t >= low && t <= Math.PI).sort((a, b) => a - b);
  const kept = [];
  for (const t of sorted) if (!kept.length || t - kept[kept.length - 1] > apart * t) kept.push(t);
  kept[kept.length - 1] = Math.PI;
  return kept;
}

/** L of the measured positions and velocities per command. */
export function loopOf({ q, v }, kp, kd) {
  const L = zeros(q.n);
  for (let i = 0, at = 0; i < q.n; i++) {
    for (let j = 0; j < q.n; j++, at++) {
      L.re[at] = kp[i] * q.re[at] + kd[i] * v.re[at];
      L.im[at] = kp[i] * q.im[at] + kd[i] * v.im[at];
    }
  }
  return L;
}

/** A robot's responses on a grid of |z| = e^log, kept for whatever its gains are. */
export function responses(open, fine, log = OUTSIDE) {
  const radius = Math.exp(log);
  const at = (t) => ({ t, P: open.respond(radius * Math.cos(t), radius * Math.sin(t)) });
  return { open, at, log, points: angles(open, fine, log).map(at) };
}

/**
 * A closed loop with gains `kp`, `kd` of the joints, on the grid of `responses`.
 *
 * `count(g)` is the number of roots outside with all gains times g; `at(t)` L on the unit circle,
 * `beyond(zr, zi)` anywhere; `points`: {t, L, roots, before}, the eigenvalues of L there, and those
 * of the point before in their order; `refine(angles)` puts more in.
 */
export function closedLoop(known, kp, kd) {
  const { open } = known;
  const own = (point) => {
    const L = loopOf(point.P, kp, kd);
    return { t: point.t, P: point.P, L, roots: eigenvalues(L) };
  };
  const points = known.points.map(own);
  const origin = own(known.at(0));
  const outside = open.poles.filter(({ re, im }) => Math.hypot(re, im) > Math.exp(known.log)).length;
  const follow = (one, i) => (one.before = matched(one, i ? points[i - 1] : origin));
  points.forEach(follow);

  function count(g) {
    let [total, low] = [0, 0];
    for (let i = 0; i < points.length; i++) {
      const { t, roots, before } = points[i];
      const { sum, largest } = turned(before, roots, g);
      if (largest > LARGEST_TURN && t - low > 1e-8 * t && points.length < MOST_POINTS) {
        points.splice(i, 0, own(known.at(0.5 * (low + t))));
        follow(points[i], i);
        follow(points[i + 1], i + 1);
        i--;
        continue;
      }
      [total, low] = [total + sum, t];
    }
    return outside - Math.round(total / Math.PI);
  }

  /** More points, where something narrow is. */
  function refine(more) {
    const all = new Set(points.map(({ t }) => t));
    const added = more.filter((t) => t > points[0].t && t < Math.PI && !all.has(t));
    points.push(...added.map((t) => own(known.at(t))));
    points.sort((a, b) => a.t - b.t);
    points.forEach(follow);
  }

  const beyond = (zr, zi) => loopOf(open.respond(zr, zi), kp, kd);
  const at = (t) => beyond(Math.cos(t), Math.sin(t));
  return { open, known, kp, kd, points, count, refine, at, beyond };
}

/** By how much the factors 1 + g l_i turn between two points, together and the one that turns most. */
function turned(before, after, g) {
  let [sum, largest] = [0, 0];
  for (let i = 0; i < before.length; i++) {
    const [a, b] = [before[i], after[i]];
    const [ar, ai, br, bi] = [1 + g * a.re, g * a.im, 1 + g * b.re, g * b.im];
    const angle = Math.atan2(ar * bi - ai * br, ar * br + ai * bi);
    sum += angle;
    largest = Math.max(largest, Math.abs(angle));
  }
  return { sum, largest };
}

/** The eigenvalues of a point in the order of those of another: the nearest ones first. */
export function matched({ roots: goals }, { roots }) {
  const n = roots.length;
  const size = ({ re, im }) => Math.sqrt(re * re + im * im);
  const [found, sizes] = [new Array(n).fill(null), roots.map(size)];
  const [taken, nearest, apart] = [new Uint8Array(n), new Int32Array(n), new Float64Array(n)];
  const look = (i) => {
    const { re, im } = goals[i];
    const own = size(goals[i]);
    let [best, place] = [Infinity, -1];
    for (let j = 0; j < n; j++) {
      if (taken[j]) continue;
      const [x, y, both] = [re - roots[j].re, im - roots[j].im, own + sizes[j] || 1];
      const far = (x * x + y * y) / (both * both);
      if (place < 0 || far < best) [best, place] = [far, j];
    }
    [apart[i], nearest[i]] = [best, place];
  };
  for (let i = 0; i < n; i++) look(i);
  for (let k = 0; k < n; k++) {
    let first = -1;
    for (let i = 0; i < n; i++) {
      if (found[i] === null && (first < 0 || apart[i] < apart[first])) first = i;
    }
    found[first] = roots[nearest[first]];
    taken[nearest[first]] = 1;
    for (let i = 0; i < n; i++) if (found[i] === null && nearest[i] === nearest[first]) look(i);
  }
  return found;
}

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
 */
export function gainLimit(loop, up, swing = false) {
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
    const counts = swing ? together[i][0].t > 0 && after > before : after !== before;
    if (counts) {
      return { ...limited(loop, together[i], sign, at, [start, beyond], before), before, after };
    }
    [before, start] = [after, beyond];
  }
  return null;
}

function limited(loop, candidates, sign, at, [start, beyond], before) {
  const exact = candidates.map((one) => {
    if (one.t > 0 && one.t < Math.PI) {
      const { t, value, sure } = refined(loop, one, (l) => l.im);
      return { t, d: sure && value.re < 0 ? sign * Math.log(-1 / value.re) : Infinity };
    }
    return { t: one.t, d: sign * Math.log(-1 / nearestRoot(loop, one.t, one.value).re) };
  });
  let { t, d } = exact.reduce((a, b) => (b.d < a.d ? b : a));
  const near = Math.max(d, 1e-3);
  // Slow growth shows on a circle a little outside only further beyond.
  const beside = [1, 10, 100].some((x) => at(d + x * BESIDE * near) !== before);
  if (!(d > 0) || !beside || at(d - BESIDE * near) !== before) {
    let [low, high] = [start, beyond];
    while (high - low > 1e-5 * high) {
      const middle = 0.5 * (low + high);
      if (at(middle) === before) low = middle;
      else high = middle;
    }
    d = 0.5 * (low + high);
  }
  return { factor: Math.exp(sign * d), t };
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
  const grows = (delay) => {
    const later = open.later(delay * period);
    return rootsBeyond({ open: later, kp, kd }, OUTSIDE) > before;
  };
  let [low, high] = [0, 0];
  const beyond = [BESIDE, 10 * BESIDE, 100 * BESIDE].some((x) => grows(best.delay * (1 + x) + x));
  if (!beyond) return { delay: NaN, t: best.t };
  const early = [0.25, 0.5, 0.75, 1 - BESIDE].map((x) => x * best.delay).find(grows);
  if (early === undefined) return { delay: best.delay * period, t: best.t };
  for (high = early; high - low > 1e-6 * high; ) {
    const middle = 0.5 * (low + high);
    if (grows(middle)) high = middle;
    else low = middle;
    yield;
  }
  return { delay: high * period, t: best.t };
}

/** Delays [periods] and angles near a guess at which an eigenvalue of L is -1. */
function marginal({ open, kp, kd }, { t, delay }) {
  const at = (angle, late) => {
    const { respond } = open.later(late * open.period);
    return eigenvalues(loopOf(respond(Math.cos(angle), Math.sin(angle)), kp, kd));
  };
  const near = at(t, delay).filter(({ re, im }) => Math.hypot(re + 1, im) < AROUND);
  return near.map((value) => newton(at, t, delay, value)).filter((found) => found !== null);
}

/** Newton's method over angle and delay, from an eigenvalue near -1. */
function newton(at, t, delay, first) {
  let [x, y, value] = [t, delay, first];
  const eigenvalue = (angle, late) => {
    const far = (one) => Math.hypot(one.re - value.re, one.im - value.im);
    return at(angle, late).reduce((a, b) => (far(b) < far(a) ? b : a));
  };
  for (let i = 0; i < 20; i++) {
    const [fr, fi] = [value.re + 1, value.im];
    if (Math.hypot(fr, fi) < 1e-12) return { t: x, delay: y };
    const [dx, dy] = [1e-6 * x, 1e-6 * (y + 1e-3)];
    const [along, late] = [eigenvalue(x + dx, y), eigenvalue(x, y + dy)];
    const [ar, ai] = [(along.re - value.re) / dx, (along.im - value.im) / dx];
    const [br, bi] = [(late.re - value.re) / dy, (late.im - value.im) / dy];
    const det = ar * bi - ai * br;
    const step = [(fr * bi - fi * br) / det, (ar * fi - ai * fr) / det];
    [x, y] = [x - step[0], Math.max(y - step[1], 0)];
    if (!(x > 0 && x <= Math.PI && Math.abs(y - delay) < 2)) return null;
    value = eigenvalue(x, y);
    if (Math.hypot(step[0] / x, step[1] / (y + 1e-3)) < 1e-12) return { t: x, delay: y };
  }
  return null;
}

/** Number of roots outside a circle of radius exp(rate T), by the turns of 1 + l_i. */
export function rootsBeyond(loop, log) {
  const { open, kp, kd } = loop;
  const radius = Math.exp(log);
  const at = (t) => {
    const P = open.respond(radius * Math.cos(t), radius * Math.sin(t));
    return { roots: eigenvalues(loopOf(P, kp, kd)) };
  };
  const between = (low, a, high, b, depth) => {
    const { sum, largest } = turned(a.roots, matched(a, b), 1);
    if (largest < LARGEST_TURN || depth > 40) return sum;
    const middle = 0.5 * (low + high);
    const c = at(middle);
    return between(low, a, middle, c, depth + 1) + between(middle, c, high, b, depth + 1);
  };
  let [low, before, total] = [0, at(0), 0];
  for (const t of angles(open, false, log)) {
    const here = at(t);
    total += between(low, before, t, here, 0);
    [low, before] = [t, here];
  }
  const outside = open.poles.filter(({ re, im }) => Math.hypot(re, im) > radius).length;
  return outside - Math.round(total / Math.PI);
}

/** S = (I + L)^-1 of an L. */
export const sensitivityOf = (L) => inverse(shifted(L, 1, 1));

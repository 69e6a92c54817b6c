// A robot's loop closed: how many roots are outside the unit circle.
//
//   L = kp Q + kd V,     det(I + g L(z)) = prod (1 + g l_i(z)) over the eigenvalues of L.
//
// As z runs once around the circle, 1 + ... turns by as many times as there are roots of the open
// loop outside it, less those of the closed one.

import { eigenvalues, inverse, shifted, zeros } from "./matrices.js";

// Where roots are counted: this far outside the circle, as static ones are 1 but for rounding.
export const OUTSIDE = 1.5e-7;
// Places around a root in widths of its resonance.
const FINE = [-4, -2, -1, -0.5, 0, 0.5, 1, 2, 4];
const COARSE = [-1.5, 0, 1.5];
const LARGEST_TURN = 0.9;
const MOST_POINTS = 4000;

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
  const { re, im } = L;
  for (let i = 0, at = 0; i < q.n; i++) {
    const [stiff, damping] = [kp[i], kd[i]];
    for (let j = 0; j < q.n; j++, at++) {
      re[at] = stiff * q.re[at] + damping * v.re[at];
      im[at] = stiff * q.im[at] + damping * v.im[at];
    }
  }
  return L;
}

/** What a function in steps returns. */
export function finished(steps) {
  let step = steps.next();
  while (!step.done) step = steps.next();
  return step.value;
}

/** A robot's responses on a grid of |z| = e^log, kept for whatever its gains are; in steps. */
export function* responding(open, fine, log = OUTSIDE) {
  const radius = Math.exp(log);
  const by = (respond) => (t) => ({ t, P: respond(radius * Math.cos(t), radius * Math.sin(t)) });
  // The coarse grid is the one that is asked for again and again.
  const own = by(fine || log !== OUTSIDE ? open.respond : open.again);
  const points = [];
  for (const t of angles(open, fine, log)) {
    points.push(own(t));
    yield;
  }
  return { open, at: by(open.respond), log, points };
}

/** The same at once. */
export const responses = (...of) => finished(responding(...of));

/**
 * A closed loop with gains `kp`, `kd` of the joints, on the grid of `responses`.
 *
 * `count(g)` is the number of roots outside with all gains times g; `at(t)` L on the unit circle,
 * `beyond(zr, zi)` anywhere; `points`: {t, L, roots, before}, the eigenvalues of L there, and those
 * of the point before in their order; `refine(angles)` puts more in. It and this are in steps.
 */
export function* closing(known, kp, kd) {
  const { open } = known;
  const own = (point) => {
    const L = loopOf(point.P, kp, kd);
    return { t: point.t, P: point.P, L, roots: eigenvalues(L) };
  };
  const points = [];
  for (const point of known.points) {
    points.push(own(point));
    yield;
  }
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
  function* refine(more) {
    const all = new Set(points.map(({ t }) => t));
    const added = [];
    for (const t of more.filter((t) => t > 0 && t < Math.PI && !all.has(t))) {
      added.push(own(known.at(t)));
      yield;
    }
    points.push(...added);
    points.sort((a, b) => a.t - b.t);
    points.forEach(follow);
  }

  const beyond = (zr, zi) => loopOf(open.respond(zr, zi), kp, kd);
  const at = (t) => beyond(Math.cos(t), Math.sin(t));
  return { open, known, kp, kd, points, count, refine, at, beyond };
}

/** The same at once. */
export const closedLoop = (...of) => finished(closing(...of));

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

/** Number of roots outside a circle of radius exp(rate T), by the turns of 1 + l_i; in steps. */
export function* rootsBeyond(loop, log) {
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
    yield;
    [low, before] = [t, here];
  }
  const outside = open.poles.filter(({ re, im }) => Math.hypot(re, im) > radius).length;
  return outside - Math.round(total / Math.PI);
}

/** S = (I + L)^-1 of an L. */
export const sensitivityOf = (L) => inverse(shifted(L, 1, 1));

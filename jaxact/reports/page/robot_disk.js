// The disk margin of a robot: how much gain and phase of all joints may change at once.
//
// Each loop is multiplied by its own (1 + d_i/2) / (1 - d_i/2), |d_i| < a; all are stable up to
//
//   a = 1 / max over w of mu(S - I/2),     mu(H) <= min over D of the largest singular value of D H D^-1,
//
// D diagonal and positive. The bound is what is computed, as in Python: of one matrix by the method of
// centres (Boyd, El Ghaoui 1993) from Osborne's scaling (1960).

import { adjoint, inverse, largestSingularValue, product, shifted, zeros } from "./matrices.js";
import { sensitivityOf } from "./robot_loop.js";
import { frequencyOf } from "./robot_margins.js";
import { summit } from "./summits.js";

const SWEEPS = 12;
const TINY = 1e-150;
// Relative accuracy of the bound: of what is shown, and while its peak is looked for.
const [EXACT, SEARCHED] = [1e-9, 1e-4];
// Most steps of the method of centres, and of Newton's in each.
const [CENTRES, NEWTON] = [200, 20];
// How far a new bound keeps from the one that its scaling has, as a share of the way back.
const SHY = 0.2;
// Newton's decrement at which a centre is good enough, and above which a step is damped.
const [CENTRED, DAMPED] = [0.3, 0.25];
// Summits that are looked at: those on the grid that are this near to the highest.
const [SUMMITS, NEARLY] = [4, 0.9];
// Two values of the curve that are as near as this are its summit.
const FLAT = 1e-8;

/** D H D^-1 with D^2 the weights. */
function scaledBy(H, weights) {
  const { n } = H;
  const found = zeros(n);
  for (let i = 0, at = 0; i < n; i++) {
    for (let j = 0; j < n; j++, at++) {
      const share = Math.sqrt(weights[i] / weights[j]);
      found.re[at] = share * H.re[at];
      found.im[at] = share * H.im[at];
    }
  }
  return found;
}

/** Osborne's weights, a few sweeps: rows and columns of D H D^-1 have equal sizes. */
function balancing({ n, re, im }) {
  const size = re.map((x, at) => x * x + im[at] * im[at]);
  const weights = new Float64Array(n).fill(1);
  for (let sweep = 0; sweep < SWEEPS; sweep++) {
    for (let i = 0; i < n; i++) {
      let row = 0;
      let column = 0;
      for (let j = 0; j < n; j++) {
        if (j === i) continue;
        row += size[i * n + j];
        column += size[j * n + i];
      }
      if (!(row > TINY && column > TINY)) continue;
      const ratio = Math.sqrt(column / row);
      for (let j = 0; j < n; j++) {
        size[i * n + j] *= ratio;
        size[j * n + i] /= ratio;
      }
      weights[i] *= ratio;
    }
  }
  return weights;
}

/** The same sum of weights as there are rows. */
function normalised(weights) {
  const sum = weights.reduce((all, x) => all + x, 0);
  return weights.map((x) => (x * weights.length) / sum);
}

/**
 * The bound of mu(H), never too small: {value, weights} of the best D^2; in steps.
 *
 * With P = D^2 the square of the bound is the smallest b for which b P - H^H P H is not indefinite.
 */
export function* bound(H, accuracy = EXACT, start = balancing(H)) {
  const first = largestSingularValue(scaledBy(H, start));
  let weights = normalised(start);
  if (H.n === 1 || first === 0) return { value: first, weights };
  const unit = shifted(H, 0, 1 / first);
  const largest = (own) => largestSingularValue(scaledBy(unit, own)) ** 2;
  let best = { size: 1, weights };
  let level = 1 + SHY;
  for (let i = 0; i < CENTRES; i++) {
    weights = centre(unit, weights, level);
    yield;
    // Near the best bound F is singular but for rounding, which may lead anywhere: what was found
    // before is a bound all the same.
    const [least, most] = [Math.min(...weights), Math.max(...weights)];
    if (!(least > TINY * most && most < Infinity)) break;
    const size = largest(weights);
    if (size < best.size) best = { size, weights };
    if (level - size <= accuracy * size) break;
    level = size + SHY * (level - size);
  }
  return { value: first * Math.sqrt(best.size), weights: best.weights };
}

/** Weights p of the same sum near the largest det F, F = level P - H^H P H; by Newton's method. */
function centre(H, weights, level) {
  const { n } = H;
  const back = adjoint(H);
  let own = weights;
  for (let i = 0; i < NEWTON; i++) {
    const { right, curvature } = derivatives(H, back, own, level);
    const step = solvedWithSum(curvature, right);
    let square = 0;
    for (let a = 0; a < n; a++) {
      for (let b = 0; b < n; b++) square += step[a] * curvature[a * n + b] * step[b];
    }
    const decrement = Math.sqrt(Math.max(square, 0));
    // Damped, so that F stays positive: Newton's step for a self-concordant function.
    const share = decrement > DAMPED ? 1 / (1 + decrement) : 1;
    own = own.map((x, a) => x + share * step[a]);
    if (!(decrement >= CENTRED)) break;
  }
  return own;
}

/**
 * Of log det F over the weights, F = sum of p_i F_i, F_i = level e_i e_i^T - h_i^H h_i of the rows of
 * H: tr G F_i, and tr G F_i G F_j, with G = F^-1.
 */
function derivatives(H, back, weights, level) {
  const { n } = H;
  const weighted = (x, at) => -x * weights[Math.floor(at / n)];
  const F = product(back, { n, re: H.re.map(weighted), im: H.im.map(weighted) });
  for (let i = 0; i < n; i++) F.re[i * (n + 1)] += level * weights[i];
  const G = inverse(F);
  const HG = product(H, G);
  const HGH = product(HG, back);
  const square = ({ re, im }, at) => re[at] * re[at] + im[at] * im[at];
  const right = new Float64Array(n);
  const curvature = new Float64Array(n * n);
  for (let i = 0, at = 0; i < n; i++) {
    right[i] = level * G.re[i * (n + 1)] - HGH.re[i * (n + 1)];
    for (let j = 0; j < n; j++, at++) {
      const mixed = square(HG, at) + square(HG, j * n + i);
      curvature[at] = level * level * square(G, at) - level * mixed + square(HGH, at);
    }
  }
  return { right, curvature };
}

/** x with A x = b up to a multiple of (1, ..., 1), and a sum of 0; by elimination with exchanges. */
function solvedWithSum(A, b) {
  const n = b.length;
  const rows = Array.from({ length: n + 1 }, (_, i) =>
    i < n ? [...A.subarray(i * n, (i + 1) * n), 1, b[i]] : [...new Array(n).fill(1), 0, 0],
  );
  for (let k = 0; k <= n; k++) {
    let best = k;
    for (let i = k + 1; i <= n; i++) if (Math.abs(rows[i][k]) > Math.abs(rows[best][k])) best = i;
    [rows[k], rows[best]] = [rows[best], rows[k]];
    for (let i = k + 1; i <= n; i++) {
      const share = rows[i][k] / rows[k][k];
      if (share === 0) continue;
      for (let j = k; j <= n + 1; j++) rows[i][j] -= share * rows[k][j];
    }
  }
  const x = new Float64Array(n + 1);
  for (let k = n; k >= 0; k--) {
    let sum = rows[k][n + 1];
    for (let j = k + 1; j <= n; j++) sum -= rows[k][j] * x[j];
    x[k] = sum / rows[k][k];
  }
  return x.subarray(0, n);
}

/**
 * The disk margin {margin, frequency [rad/s]} of all joints at once, each changed by itself; of a loop
 * with S at its points. In steps.
 */
export function* diskMargin(loop) {
  const { points } = loop;
  const known = new Map();
  const at = function* (i) {
    if (!known.has(i)) known.set(i, yield* bound(halved(points[i].S), SEARCHED));
    return known.get(i);
  };
  let peak = { t: points[0].t, value: 0 };
  for (const top of yield* tops(points)) {
    const i = yield* climbed(at, top, points.length);
    let { weights } = known.get(i);
    const curve = function* (t) {
      const here = yield* bound(halved(sensitivityOf(loop.at(t))), EXACT, weights);
      ({ weights } = here);
      return here.value;
    };
    const [low, high] = [points[Math.max(i - 1, 0)], points[Math.min(i + 1, points.length - 1)]];
    const own = yield* summit(curve, low.t, points[i].t, high.t, FLAT);
    if (own.value > peak.value) peak = own;
  }
  return { margin: 1 / peak.value, frequency: frequencyOf(loop, peak) };
}

const halved = (S) => shifted(S, -0.5, 1);

/** Points where the curve with Osborne's scaling is highest among its neighbours, the highest first. */
function* tops(points) {
  const heights = points.map(({ peaks }) => peaks[2]);
  const order = points.map((_, i) => i).sort((a, b) => heights[b] - heights[a]);
  let highest = 0;
  for (const i of order) {
    // The scaling only lowers: what is below without it does not matter.
    if (heights[i] < NEARLY * highest) break;
    const H = halved(points[i].S);
    heights[i] = Math.min(heights[i], largestSingularValue(scaledBy(H, balancing(H))));
    highest = Math.max(highest, heights[i]);
    yield;
  }
  return order
    .filter((i) => heights[i] >= NEARLY * highest)
    .filter((i) => !(heights[i - 1] > heights[i]) && !(heights[i + 1] > heights[i]))
    .sort((a, b) => heights[b] - heights[a])
    .slice(0, SUMMITS);
}

/** The point that is highest among its neighbours with the best scalings, from another one upwards. */
function* climbed(at, from, count) {
  for (let i = from; ; ) {
    let best = i;
    for (const near of [i - 1, i + 1]) {
      if (near >= 0 && near < count && (yield* at(near)).value > (yield* at(best)).value) best = near;
    }
    if (best === i) {
      yield* at(i);
      return i;
    }
    i = best;
  }
}

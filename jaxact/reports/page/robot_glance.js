// What is shown of a robot while something moves: whether it is stable, and an outline of S and T.
//
// From a point of the circle to the next, det(I + L) turns by the angles of the pivots p_k of
//
//   E = (I + L_a)^-1 (I + L_b),     E = lower x upper,
//
// if the Hermitian part of D^-1 E D is positive definite, D diagonal. Then so is that of all
// matrices on the line from I to E and of their Schur complements, the first entries of which are the
// pivots: none leaves the right half plane on the way. Eigenvalues, which cost ten times as much, are
// for the numbers that are shown at rest.

import { inverse, product, zeros } from "./matrices.js";
import { loopOf } from "./robot_loop.js";

const MOST_POINTS = 2000;
// Of a robot with more joints the outline has fewer points.
const FEW_JOINTS = 12;
const NARROWEST = 1e-8;
// Steps of Lanczos's method: enough for a line in a picture.
const STEPS = 8;
const HALVINGS = 40;

/**
 * The number of roots outside the circle, null where it is not known, and points {t, peaks}, the
 * largest singular values of S and T as a picture needs them; of `responses`. In steps.
 */
export function* glance(known, kp, kd) {
  const { open } = known;
  const weights = scales(kp, kd, open.period);
  const [E, factors] = [zeros(open.joints), zeros(open.joints)];
  const own = ({ t, P }) => {
    const M = loopOf(P, kp, kd);
    for (let at = 0; at < M.re.length; at += M.n + 1) M.re[at] += 1;
    return { t, M, S: inverse(M) };
  };
  const turn = (a, b) => {
    product(a.S, b.M, E);
    if (accretive(E, weights, factors)) return pivotsTurn(E);
    if (b.t - a.t <= NARROWEST * b.t || left-- <= 0) return NaN;
    const middle = own(known.at(0.5 * (a.t + b.t)));
    return turn(a, middle) + turn(middle, b);
  };
  let left = MOST_POINTS;
  let [before, total] = [own(known.at(0)), 0];
  const points = [];
  const stride = Math.max(1, Math.round(open.joints / FEW_JOINTS));
  for (let i = 0; i < known.points.length; i++) {
    const here = own(known.points[i]);
    total += turn(before, here);
    if (i % stride === 0 || i + 1 === known.points.length) {
      points.push({ t: here.t, peaks: [roughly(here.S, 0, 1), roughly(here.S, 1, -1)] });
    }
    before = here;
    yield;
  }
  const outside = open.poles.filter(({ re, im }) => Math.hypot(re, im) > Math.exp(known.log)).length;
  return { unstable: Number.isNaN(total) ? null : outside - Math.round(total / Math.PI), points };
}

/** Of each joint the size of its gains, whose root makes L nearly symmetric. */
const scales = (kp, kd, period) =>
  kp.map((own, i) => Math.sqrt(Math.hypot(own, kd[i] / period)) || 1);

/** Whether the Hermitian part of D^-1 E D is positive definite, by Cholesky's factors, put there. */
function accretive({ n, re, im }, weights, { re: lr, im: li }) {
  for (let i = 0; i < n; i++) {
    for (let j = 0; j <= i; j++) {
      const there = i * n + j;
      const back = j * n + i;
      const share = weights[j] / weights[i];
      let x = 0.5 * (re[there] * share + re[back] / share);
      let y = 0.5 * (im[there] * share - im[back] / share);
      for (let k = 0, a = i * n, b = j * n; k < j; k++, a++, b++) {
        x -= lr[a] * lr[b] + li[a] * li[b];
        y -= li[a] * lr[b] - lr[a] * li[b];
      }
      if (i === j) {
        if (!(x > 0)) return false;
        lr[there] = Math.sqrt(x);
      } else {
        lr[there] = x / lr[j * n + j];
        li[there] = y / lr[j * n + j];
      }
    }
  }
  return true;
}

/** By how much the pivots of E turn from 1, together; E becomes its factors. */
function pivotsTurn({ n, re, im }) {
  let sum = 0;
  for (let k = 0; k < n; k++) {
    const x = re[k * n + k];
    const y = im[k * n + k];
    sum += Math.atan2(y, x);
    const size = x * x + y * y;
    for (let i = k + 1; i < n; i++) {
      const a = re[i * n + k];
      const b = im[i * n + k];
      const fr = (a * x + b * y) / size;
      const fi = (b * x - a * y) / size;
      for (let j = k + 1, u = i * n + k + 1, v = k * n + k + 1; j < n; j++, u++, v++) {
        re[u] -= fr * re[v] - fi * im[v];
        im[u] -= fr * im[v] + fi * re[v];
      }
    }
  }
  return sum;
}

/** The largest singular value of c I + d M to some digits, by a few steps of Lanczos's method. */
export function roughly(M, c, d) {
  const { n } = M;
  let [old, own, next] = [vector(n), vector(n), vector(n)];
  const through = vector(n);
  for (let i = 0; i < n; i++) {
    own.re[i] = Math.cos(3 * i + 1);
    own.im[i] = Math.sin(5 * i * i + 2);
  }
  scale(own, 1 / size(own));
  const [diagonal, beside] = [[], [0]];
  for (let step = 0; step < Math.min(STEPS, n); step++) {
    times(M, c, d, own, through);
    adjoint(M, c, d, through, next);
    const before = beside[step];
    let alpha = 0;
    for (let i = 0; i < n; i++) {
      next.re[i] -= before * old.re[i];
      next.im[i] -= before * old.im[i];
      alpha += own.re[i] * next.re[i] + own.im[i] * next.im[i];
    }
    for (let i = 0; i < n; i++) {
      next.re[i] -= alpha * own.re[i];
      next.im[i] -= alpha * own.im[i];
    }
    const beta = size(next);
    diagonal.push(alpha);
    if (!(beta > 1e-12 * alpha)) break;
    beside.push(beta);
    scale(next, 1 / beta);
    [old, own, next] = [own, next, old];
  }
  return Math.sqrt(largestOf(diagonal, beside));
}

/** The largest eigenvalue of a symmetric tridiagonal matrix, between bounds that are halved. */
function largestOf(diagonal, beside) {
  const around = diagonal.map((x, i) => x + beside[i] + (i + 1 < diagonal.length ? beside[i + 1] : 0));
  let [low, high] = [Math.max(...diagonal), Math.max(...around)];
  for (let i = 0; i < HALVINGS && high - low > 1e-9 * high; i++) {
    const middle = 0.5 * (low + high);
    // All pivots of middle - T are positive above the largest.
    let pivot = 1;
    const above = diagonal.every((x, k) => {
      pivot = middle - x - (k ? (beside[k] * beside[k]) / pivot : 0);
      return pivot > 0;
    });
    if (above) high = middle;
    else low = middle;
  }
  return high;
}

const vector = (n) => ({ re: new Float64Array(n), im: new Float64Array(n) });

function size({ re, im }) {
  let sum = 0;
  for (let i = 0; i < re.length; i++) sum += re[i] * re[i] + im[i] * im[i];
  return Math.sqrt(sum);
}

function scale({ re, im }, by) {
  for (let i = 0; i < re.length; i++) {
    re[i] *= by;
    im[i] *= by;
  }
}

/** y = (c I + d M) x. */
function times({ n, re, im }, c, d, x, y) {
  const { re: xr, im: xi } = x;
  for (let i = 0, at = 0; i < n; i++) {
    let a = 0;
    let b = 0;
    for (let j = 0; j < n; j++, at++) {
      a += re[at] * xr[j] - im[at] * xi[j];
      b += re[at] * xi[j] + im[at] * xr[j];
    }
    y.re[i] = c * xr[i] + d * a;
    y.im[i] = c * xi[i] + d * b;
  }
}

/** y = (c I + d M)^H x. */
function adjoint({ n, re, im }, c, d, x, y) {
  const { re: yr, im: yi } = y;
  for (let i = 0; i < n; i++) {
    yr[i] = c * x.re[i];
    yi[i] = c * x.im[i];
  }
  for (let i = 0, at = 0; i < n; i++) {
    const a = d * x.re[i];
    const b = d * x.im[i];
    for (let j = 0; j < n; j++, at++) {
      yr[j] += re[at] * a + im[at] * b;
      yi[j] += re[at] * b - im[at] * a;
    }
  }
}

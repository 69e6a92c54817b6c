// Small dense complex matrices: {n, re, im}, square, row by row.

const ITERATIONS = 60;
const SWEEPS = 30;
const EPSILON = 2 ** -52;

/** A matrix of zeros. */
export const zeros = (n) => ({ n, re: new Float64Array(n * n), im: new Float64Array(n * n) });

/** c I + d M, of real c and d. */
export function shifted(M, c, d) {
  const found = zeros(M.n);
  for (let k = 0; k < M.re.length; k++) {
    found.re[k] = d * M.re[k];
    found.im[k] = d * M.im[k];
  }
  for (let i = 0; i < M.n; i++) found.re[i * (M.n + 1)] += c;
  return found;
}

/** Swap rows a and b of an array with n columns, from one column on. */
function swap(array, n, a, b, from) {
  for (let j = from; j < n; j++) {
    const kept = array[a * n + j];
    array[a * n + j] = array[b * n + j];
    array[b * n + j] = kept;
  }
}

/** M^-1, by Gauss's and Jordan's elimination with row exchanges. */
export function inverse(M) {
  const { n } = M;
  const found = { n, re: M.re.slice(), im: M.im.slice() };
  const { re, im } = found;
  const exchanged = new Int32Array(n);
  for (let k = 0; k < n; k++) {
    const best = pivotRow(found, k);
    exchanged[k] = best;
    if (best !== k) {
      swap(re, n, k, best, 0);
      swap(im, n, k, best, 0);
    }
    divideRow(found, k);
    for (let i = 0; i < n; i++) if (i !== k) lessRow(found, i, k);
  }
  for (let k = n - 1; k >= 0; k--) {
    if (exchanged[k] === k) continue;
    swapColumns(re, n, k, exchanged[k]);
    swapColumns(im, n, k, exchanged[k]);
  }
  return found;
}

/** The row from k on whose entry in column k is the largest. */
function pivotRow({ n, re, im }, k) {
  let best = k;
  let largest = -1;
  for (let i = k, at = k * n + k; i < n; i++, at += n) {
    const size = re[at] * re[at] + im[at] * im[at];
    if (size > largest) {
      best = i;
      largest = size;
    }
  }
  return best;
}

/** Row k over its pivot, in the place of which there is its inverse. */
function divideRow({ n, re, im }, k) {
  const pivot = k * n + k;
  const size = re[pivot] * re[pivot] + im[pivot] * im[pivot];
  const x = re[pivot] / size;
  const y = -im[pivot] / size;
  re[pivot] = 1;
  im[pivot] = 0;
  for (let at = k * n; at < (k + 1) * n; at++) {
    const a = re[at];
    const b = im[at];
    re[at] = a * x - b * y;
    im[at] = a * y + b * x;
  }
}

/** Row i less row k times what is in column k, in the place of which is what the inverse has. */
function lessRow({ n, re, im }, i, k) {
  const place = i * n + k;
  const fr = re[place];
  const fi = im[place];
  re[place] = 0;
  im[place] = 0;
  for (let j = 0, u = i * n, v = k * n; j < n; j++, u++, v++) {
    const a = re[v];
    const b = im[v];
    re[u] -= fr * a - fi * b;
    im[u] -= fr * b + fi * a;
  }
}

/** A B, two rows of B at once; into E, where it is given. */
export function product(A, B, E = zeros(A.n)) {
  const { n, re, im } = E;
  const { re: br, im: bi } = B;
  re.fill(0);
  im.fill(0);
  for (let i = 0; i < n; i++) {
    for (let k = 0, at = i * n; k < n; k += 2, at += 2) {
      const more = k + 1 < n;
      const a = A.re[at];
      const b = A.im[at];
      const c = more ? A.re[at + 1] : 0;
      const d = more ? A.im[at + 1] : 0;
      for (let j = 0, u = i * n, v = k * n, w = more ? v + n : v; j < n; j++, u++, v++, w++) {
        const e = br[v];
        const f = bi[v];
        const g = br[w];
        const h = bi[w];
        re[u] += a * e - b * f + c * g - d * h;
        im[u] += a * f + b * e + c * h + d * g;
      }
    }
  }
  return E;
}

/** The adjoint of M, conjugated and turned over. */
export function adjoint(M) {
  const { n } = M;
  const found = zeros(n);
  for (let i = 0; i < n; i++) {
    for (let j = 0; j < n; j++) {
      found.re[j * n + i] = M.re[i * n + j];
      found.im[j * n + i] = -M.im[i * n + j];
    }
  }
  return found;
}

function swapColumns(array, n, a, b) {
  for (let at = 0; at < n * n; at += n) {
    const kept = array[at + a];
    array[at + a] = array[at + b];
    array[at + b] = kept;
  }
}

/** Singular values, the largest first, by Jacobi's rotations of columns (Hestenes). */
export function singularValues(M) {
  const { n } = M;
  // Columns as rows, so that each lies together.
  const [re, im] = [M.re, M.im].map((part) => {
    const turned = new Float64Array(n * n);
    for (let i = 0; i < n; i++) for (let j = 0; j < n; j++) turned[j * n + i] = part[i * n + j];
    return turned;
  });
  for (let sweep = 0, largest = 1; sweep < SWEEPS && largest > 1e-9; sweep++) {
    largest = 0;
    for (let p = 0; p + 1 < n; p++) {
      for (let q = p + 1; q < n; q++) largest = Math.max(largest, rotated(re, im, n, p * n, q * n));
    }
  }
  const sizes = new Float64Array(n);
  for (let j = 0; j < n; j++) {
    let square = 0;
    for (let k = j * n; k < (j + 1) * n; k++) square += re[k] * re[k] + im[k] * im[k];
    sizes[j] = Math.sqrt(square);
  }
  return sizes.sort().reverse();
}

/** The largest singular value, from M^H M, which is as exact for it, and quicker. */
export function largestSingularValue(M) {
  const { n, re, im } = M;
  const square = zeros(n);
  for (let i = 0; i < n; i++) {
    for (let j = i; j < n; j++) {
      let x = 0;
      let y = 0;
      for (let k = 0, a = i, b = j; k < n; k++, a += n, b += n) {
        x += re[a] * re[b] + im[a] * im[b];
        y += re[a] * im[b] - im[a] * re[b];
      }
      square.re[i * n + j] = x;
      square.im[i * n + j] = y;
      square.re[j * n + i] = x;
      square.im[j * n + i] = -y;
    }
  }
  return Math.sqrt(Math.max(...eigenvalues(square).map(({ re: size }) => size)));
}

/** Turn two columns until they are orthogonal; gives how little they were. */
function rotated(re, im, n, p, q) {
  let [a, b, cr, ci] = [0, 0, 0, 0];
  for (let k = 0; k < n; k++) {
    const xr = re[p + k];
    const xi = im[p + k];
    const yr = re[q + k];
    const yi = im[q + k];
    a += xr * xr + xi * xi;
    b += yr * yr + yi * yi;
    cr += xr * yr + xi * yi;
    ci += xr * yi - xi * yr;
  }
  const size = Math.hypot(cr, ci);
  const share = size / Math.sqrt(a * b || 1);
  if (share <= 1e-12) return 0;
  const tau = (b - a) / (2 * size);
  const t = (tau >= 0 ? 1 : -1) / (Math.abs(tau) + Math.sqrt(1 + tau * tau));
  const c = 1 / Math.sqrt(1 + t * t);
  const [sr, si] = [(c * t * cr) / size, (c * t * ci) / size];
  for (let k = 0; k < n; k++) {
    const xr = re[p + k];
    const xi = im[p + k];
    const yr = re[q + k];
    const yi = im[q + k];
    re[p + k] = c * xr - (sr * yr + si * yi);
    im[p + k] = c * xi - (sr * yi - si * yr);
    re[q + k] = c * yr + (sr * xr - si * xi);
    im[q + k] = c * yi + (sr * xi + si * xr);
  }
  return share;
}

/** Eigenvalues [{re, im}], by elimination to Hessenberg's form and the shifted QR method. */
export function eigenvalues(M) {
  const { n } = M;
  const [re, im] = [M.re.slice(), M.im.slice()];
  reduced(re, im, n);
  const found = [];
  let [end, tries] = [n - 1, 0];
  while (end >= 0) {
    let first = end;
    for (; first > 0; first--) {
      const size = (i, j) => Math.abs(re[i * n + j]) + Math.abs(im[i * n + j]);
      const around = size(first - 1, first - 1) + size(first, first);
      if (size(first, first - 1) <= EPSILON * around) break;
    }
    if (first === end) {
      found.push({ re: re[end * (n + 1)], im: im[end * (n + 1)] });
      [end, tries] = [end - 1, 0];
    } else {
      if (tries >= ITERATIONS) return Array.from({ length: n }, () => ({ re: NaN, im: NaN }));
      iterated(re, im, n, first, end, tries++);
    }
  }
  return found;
}

/** Hessenberg's form by elimination with exchanges, in place. */
function reduced(re, im, n) {
  for (let k = 1; k + 1 < n; k++) {
    let [best, largest] = [k, 0];
    for (let i = k; i < n; i++) {
      const size = Math.hypot(re[i * n + k - 1], im[i * n + k - 1]);
      if (size > largest) [best, largest] = [i, size];
    }
    if (largest === 0) continue;
    if (best !== k) {
      for (const part of [re, im]) {
        swap(part, n, k, best, k - 1);
        for (let i = 0; i < n; i++) {
          const kept = part[i * n + k];
          part[i * n + k] = part[i * n + best];
          part[i * n + best] = kept;
        }
      }
    }
    const [x, y] = [re[k * n + k - 1], im[k * n + k - 1]];
    const size = x * x + y * y;
    for (let i = k + 1; i < n; i++) {
      const [a, b] = [re[i * n + k - 1], im[i * n + k - 1]];
      if (a === 0 && b === 0) continue;
      const fr = (a * x + b * y) / size;
      const fi = (b * x - a * y) / size;
      [re[i * n + k - 1], im[i * n + k - 1]] = [0, 0];
      for (let j = k; j < n; j++) {
        const u = re[k * n + j];
        const v = im[k * n + j];
        re[i * n + j] -= fr * u - fi * v;
        im[i * n + j] -= fr * v + fi * u;
      }
      for (let j = 0; j < n; j++) {
        const u = re[j * n + i];
        const v = im[j * n + i];
        re[j * n + k] += fr * u - fi * v;
        im[j * n + k] += fr * v + fi * u;
      }
    }
  }
}

/** The root of a complex number with a real part of at least 0. */
function root(x, y) {
  const size = Math.hypot(x, y);
  const re = Math.sqrt(0.5 * (size + Math.abs(x)));
  const im = re > 0 ? y / (2 * re) : 0;
  return x >= 0 ? [re, im] : [Math.abs(im), y >= 0 ? re : -re];
}

/** Wilkinson's shift: the eigenvalue of the last two rows that is nearer to the last entry. */
function shift(re, im, n, end) {
  const at = (i, j) => [re[i * n + j], im[i * n + j]];
  const [[ar, ai], [br, bi]] = [at(end - 1, end - 1), at(end - 1, end)];
  const [[cr, ci], [dr, di]] = [at(end, end - 1), at(end, end)];
  const [hr, hi] = [0.5 * (ar - dr), 0.5 * (ai - di)];
  const [pr, pi] = [br * cr - bi * ci, br * ci + bi * cr];
  let [sr, si] = root(hr * hr - hi * hi + pr, 2 * hr * hi + pi);
  if (hr * sr + hi * si < 0) [sr, si] = [-sr, -si];
  const [qr, qi] = [hr + sr, hi + si];
  const size = qr * qr + qi * qi || 1;
  return [dr - (pr * qr + pi * qi) / size, di - (pi * qr - pr * qi) / size];
}

/** One step of the QR method between two rows, by Givens's rotations. */
function iterated(re, im, n, first, end, tries) {
  let [sr, si] = shift(re, im, n, end);
  if (tries === 10 || tries === 20) {
    sr = Math.hypot(re[end * n + end - 1], im[end * n + end - 1]);
    si = 0;
  }
  for (let i = first; i <= end; i++) {
    re[i * (n + 1)] -= sr;
    im[i * (n + 1)] -= si;
  }
  const turns = [];
  for (let k = first; k < end; k++) {
    const [xr, xi] = [re[k * (n + 1)], im[k * (n + 1)]];
    const [yr, yi] = [re[(k + 1) * n + k], im[(k + 1) * n + k]];
    const size = Math.sqrt(xr * xr + xi * xi + yr * yr + yi * yi) || 1;
    // (a, b; -conj b, conj a) with conj a = x / size, conj b = y / size
    const [ar, ai, br, bi] = [xr / size, -xi / size, yr / size, -yi / size];
    turns.push([ar, ai, br, bi]);
    for (let j = k; j <= end; j++) {
      const u = k * n + j;
      const v = u + n;
      const ur = re[u];
      const ui = im[u];
      const vr = re[v];
      const vi = im[v];
      re[u] = ar * ur - ai * ui + br * vr - bi * vi;
      im[u] = ar * ui + ai * ur + br * vi + bi * vr;
      re[v] = -br * ur - bi * ui + ar * vr + ai * vi;
      im[v] = -br * ui + bi * ur + ar * vi - ai * vr;
    }
  }
  for (let k = first; k < end; k++) {
    const [ar, ai, br, bi] = turns[k - first];
    for (let i = first; i <= Math.min(k + 1, end); i++) {
      const u = i * n + k;
      const v = u + 1;
      const ur = re[u];
      const ui = im[u];
      const vr = re[v];
      const vi = im[v];
      // times the rotation's adjoint
      re[u] = ur * ar + ui * ai + vr * br + vi * bi;
      im[u] = ui * ar - ur * ai + vi * br - vr * bi;
      re[v] = -(ur * br - ui * bi) + vr * ar - vi * ai;
      im[v] = -(ur * bi + ui * br) + vr * ai + vi * ar;
    }
  }
  for (let i = first; i <= end; i++) {
    re[i * (n + 1)] += sr;
    im[i * (n + 1)] += si;
  }
}

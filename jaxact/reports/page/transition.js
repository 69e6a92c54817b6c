// What a held command does to a joint behind its actuator, exactly:
//
//   f'' + 2 zeta wn f' + wn^2 f = wn^2 u,    m v' = f - c v - k q,    q' = v.
//
// With the time t as unit and the acceleration a = f/m for the force, x = wn t:
//
//   (q, v t, a t^2, a'/wn t^2)' = (v, a - (c t/m) v - (k t^2/m) q, x a'/wn,
//                                  x (u - a) - 2 zeta x a'/wn)

const TERMS = 16;

const product = (a, b) =>
  a.map((row) => b[0].map((_, j) => row.reduce((sum, value, k) => sum + value * b[k][j], 0)));

/** exp(A) - 1: Taylor's series of A / 2^n, then n times E <- 2 E + E^2, which keeps slow rates'
 * digits beside fast ones (Higham, Functions of Matrices, chapter 10). */
export function exponentialLessOne(matrix) {
  const norm = Math.max(...matrix.map((row) => row.reduce((sum, x) => sum + Math.abs(x), 0)));
  const halvings = Math.max(0, Math.ceil(Math.log2(norm / 0.5)));
  const small = matrix.map((row) => row.map((x) => x * 2 ** -halvings));
  let grown = small.map((row) => row.map(() => 0));
  for (let order = TERMS; order > 0; order--) {
    const next = product(small, grown);
    grown = small.map((row, i) => row.map((x, j) => (x + next[i][j]) / order));
  }
  for (let i = 0; i < halvings; i++) {
    const square = product(grown, grown);
    grown = grown.map((row, j) => row.map((x, k) => 2 * x + square[j][k]));
  }
  return grown;
}

/**
 * Phi (4, 4) and Gamma (4) of x(t) = Phi x(0) + Gamma u, x = (q, v, f, f'/wn).
 *
 * With `joint` and `servo`, the (2, 2) blocks of Phi - 1 in coordinates in which nothing is taken
 * from 1. `time` [s]; `joint`: {mass, wn, zeta, joint_damping, joint_stiffness}, wn = Infinity for
 * the ideal actuator, whose force is the command.
 */
export function transition(time, { mass, wn, zeta, joint_damping: c, joint_stiffness: k }) {
  const ideal = wn === Infinity;
  const x = ideal ? 0 : wn * time;
  const stiff = (k * time * time) / mass;
  const damped = (c * time) / mass;
  const rate = [
    [0, 1, 0, 0, 0],
    [-stiff, -damped, ideal ? 0 : 1, 0, ideal ? 1 : 0],
    [0, 0, 0, x, 0],
    [0, 0, -x, -2 * zeta * x, x],
    [0, 0, 0, 0, 0],
  ];
  const e = exponentialLessOne(rate);
  const push = [(time * time) / mass, time / mass];
  const phi = [
    [1 + e[0][0], time * e[0][1], push[0] * e[0][2], push[0] * e[0][3]],
    [(-k / mass) * time * e[0][1], 1 + e[1][1], push[1] * e[1][2], push[1] * e[1][3]],
    ideal ? [0, 0, 0, 0] : [0, 0, 1 + e[2][2], e[2][3]],
    ideal ? [0, 0, 0, 0] : [0, 0, e[3][2], 1 + e[3][3]],
  ];
  const held = ideal ? [1, 0] : [e[2][4], e[3][4]];
  const servo = ideal
    ? [
        [-1, 0],
        [0, -1],
      ]
    : [e[2].slice(2, 4), e[3].slice(2, 4)];
  const gamma = [push[0] * e[0][4], push[1] * e[1][4], ...held];
  return { phi, gamma, joint: [e[0].slice(0, 2), e[1].slice(0, 2)], servo };
}

/** M x. */
export const applied = (matrix, x) =>
  matrix.map((row) => row.reduce((sum, value, i) => sum + value * x[i], 0));

/** Phi x + Gamma u. */
export const advanced = ({ phi, gamma }, x, u) => applied(phi, x).map((q, i) => q + gamma[i] * u);

// The delay that a sampled loop still bears, exact between control periods too, as
// jaxact/analysis/sampled/delay_starts.py finds it.
//
// Whole periods turn the phase, a part of one also changes |L| and moves the gain crossovers w. At
// parts m of a period beyond the loop's delay W = (arg(-L) + 2 pi n) / (w T) whole periods more are
// critical where W is whole. W is followed from the crossovers of one part to those of the next.

import { openLoop } from "./frequencies.js";
import { sampledLoop, totalDelay } from "./loops.js";

const TURN = 2 * Math.PI;
const PARTS = 24;
const TURNS = 8;
// Crossovers up to here [rad] stay where they are but for a little, if no part moves W by more.
const FAR = 0.5;
const MOVED = 0.1;

const logGain = ({ re, im }) => 0.5 * Math.log(re * re + im * im);
const gainSlope = ({ re, im, dre, dim }) => (re * dre + im * dim) / (re * re + im * im);
const left = ({ re, im }) => Math.atan2(-im, -re);
const turned = (angle) => angle - TURN * Math.round(angle / TURN);

/**
 * Seconds, Infinity if any delay is borne.
 *
 * loop: stable; w: grid with the extremes of |L| in it; gain: its crossovers; crossing: of a
 * function's sign between two points; crossovers: of (w, L, at).
 */
export function sampledDelayLeft(loop, kp, kd, w, gain, { crossing, crossovers }) {
  const period = 1 / loop.parameters.control_rate;
  const later = lateLoops(loop, kp, kd);
  const parts = partsBeyond(totalDelay(loop.parameters) / period);
  if (!isDemanding(later, parts, w, gain, loop.end, period)) {
    return Math.min(Infinity, ...gain.map((at) => nearOne(later, at, loop.end)));
  }
  const found = parts.map((part) => {
    const at = later(part * period);
    const own = crossovers(w, w.map(at), at).filter((x) => x < loop.end);
    const rows = own.map((x) => ({ w: x, rising: Math.sign(gainSlope(at(x))) }));
    rows.push({ w: loop.end, rising: 0 });
    return rows.map((row) => ({ ...row, part, left: left(at(row.w)) }));
  });
  found.push(found[0].map((row) => ({ ...row, part: 1, left: row.left - row.w * period })));
  const candidates = found.flatMap((rows, i) => [
    ...(i ? piecesBetween(found[i - 1], rows) : []),
    ...bowsOf(rows, found[i - 1], found[i + 1]),
  ]);
  const pieces = candidates.flatMap((piece) => halves(piece, later, period, crossing));
  const where = (piece) => critical(piece, later, period, crossing);
  return Math.min(
    least(pieces, period, where),
    atTheEnd(loop.end, later, parts, period, crossing),
  );
}

/** L by w of the loop with a delay that is longer by some seconds. */
function lateLoops(loop, kp, kd) {
  const p = loop.parameters;
  return (more) => {
    const late = sampledLoop({ ...p, delay: p.delay + more });
    return (w) => openLoop(late, kp, kd, w);
  };
}

/** Parts of a period beyond a delay, the ones that end a period, where L has a kink, among them. */
function partsBeyond(own) {
  const parts = Array.from({ length: PARTS }, (_, i) => i / PARTS);
  const kink = Math.floor(own) + 1 - own;
  return (kink < 1 ? [...parts, kink] : parts).sort((a, b) => a - b);
}

/** Whether a part of a period may matter to which crossovers there are, or to their order. */
function isDemanding(later, parts, grid, gain, end, period) {
  const loops = parts.map((part) => later(part * period));
  const spread = (w) => {
    const sizes = loops.map((at) => logGain(at(w)));
    return Math.max(...sizes) - Math.min(...sizes);
  };
  const [own] = loops;
  if (logGain(own(end)) > 0) return true;
  const sizes = grid.map((w) => logGain(own(w)));
  const extreme = (i) => sizes[i] > sizes[i - 1] === sizes[i] > sizes[i + 1];
  for (let i = 1; i < grid.length; i++) {
    if (i < grid.length - 1 && !extreme(i)) continue;
    if (Math.abs(sizes[i]) < 2 * spread(grid[i])) return true;
  }
  return gain.some((w) => {
    const L = own(w);
    const turn = w * period;
    const phase = left(L) < 0 ? left(L) + TURN : left(L);
    const moved = (phase * spread(w)) / Math.abs(gainSlope(L) / period);
    return turn > FAR || !(moved < MOVED * turn * turn);
  });
}

/** What is left at a crossover that hardly moves: the phase, and what it lacks, looked up again. */
function nearOne(later, w, end) {
  const phase = left(later(0)(w));
  let [at, more] = [w, (phase < 0 ? phase + TURN : phase) / w];
  for (let i = 0; i < 60; i++) {
    const L = later(more);
    for (let j = 0; j < 6; j++) at = Math.min(at - logGain(L(at)) / gainSlope(L(at)), end);
    const rest = left(L(at)) / at;
    more += rest;
    if (Math.abs(rest) < 1e-13 * more) break;
  }
  return more;
}

/** Pieces of |L| = 1 from the crossovers of one part to the nearest of the next one, and back. */
function piecesBetween(before, after) {
  const nearest = (row, rows) =>
    rows
      .filter(({ rising }) => rising * row.rising >= 0)
      .reduce((a, b) => (a && Math.abs(a.w - row.w) <= Math.abs(b.w - row.w) ? a : b), null);
  const pieces = [];
  const add = (a, b) => {
    if (a && b && !(a.rising === 0 && b.rising === 0)) pieces.push([a, b]);
  };
  for (const row of before) add(row, nearest(row, after));
  for (const row of after) {
    const other = nearest(row, before);
    if (!pieces.some(([a, b]) => a === other && b === row)) add(other, row);
  }
  return pieces;
}

/** Neighbours of one part, where the part before or after has fewer crossovers. */
function bowsOf(rows, before, after) {
  const fewer = [before, after].some((other) => other && other.length < rows.length);
  return fewer ? rows.slice(1).map((row, i) => [rows[i], row]) : [];
}

/** Both halves of a piece, as W may turn in between; itself where its middle is not found. */
function halves(piece, later, period, crossing) {
  const [a, b] = piece;
  if (a.part === b.part) return [piece];
  const part = 0.5 * (a.part + b.part);
  const L = later(part * period);
  const w = onCurve(L, a, b, 0.5, crossing);
  if (w === null) return [piece];
  // From the side of the end of a period on which the part is.
  const middle = { ...a, w, part, left: left(L(w)), rising: a.rising || b.rising };
  return [
    [a, middle],
    [middle, b],
  ];
}

/** The crossover between those of a piece, null where there is none. */
function onCurve(L, a, b, share, crossing) {
  const size = (x) => logGain(L(x));
  const [low, high] = [Math.min(a.w, b.w), Math.max(a.w, b.w)];
  if (size(low) > 0 !== size(high) > 0) return crossing(size, low, high);
  let w = a.w + share * (b.w - a.w);
  for (let i = 0; i < 20; i++) w -= size(w) / gainSlope(L(w));
  const near = w > 0.5 * low && w < 2 * high && Math.abs(size(w)) < 1e-9;
  return near ? w : null;
}

/** The least delay of all pieces [s]. */
function least(pieces, period, where) {
  const open = pieces
    .map((piece) => withWhole(piece, period))
    .filter((piece) => piece !== null)
    .sort((a, b) => a.from - b.from);
  let best = Infinity;
  for (const piece of open) {
    if (piece.from * period >= best) break;
    best = Math.min(best, where(piece));
  }
  return best;
}

/** A piece with the least whole number that W passes on it, null if it passes none. */
function withWhole([a, b], period) {
  const change = turned(b.left - a.left);
  const first = Math.ceil(-a.left / TURN) - 1;
  for (let n = first; n < first + TURNS; n++) {
    const begin = (a.left + TURN * n) / (a.w * period);
    const end = (a.left + change + TURN * n) / (b.w * period);
    const whole = Math.ceil(Math.max(Math.min(begin, end), 0));
    if (whole <= Math.max(begin, end)) {
      const share = begin === end ? 0 : (whole - begin) / (end - begin);
      return { a, b, whole, share, from: whole + Math.min(a.part, b.part) };
    }
  }
  return null;
}

/** The delay [s] on a piece at which L = -1. */
function critical({ a, b, whole, share }, later, period, crossing) {
  const phase = (part) => {
    if (Number.isNaN(part)) return NaN;
    const L = later((whole + part) * period);
    const w = onCurve(L, a, b, (part - a.part) / (b.part - a.part), crossing);
    return w === null ? NaN : left(L(w));
  };
  let part = a.part === b.part ? NaN : crossing(phase, a.part, b.part);
  if (!(Math.abs(phase(part)) < 1e-6)) part = byNewton(a, b, whole, share, later, period);
  return part === null || whole + part <= 0 ? Infinity : (whole + part) * period;
}

/** As `critical` by Newton's method in both unknowns [periods], null where it does not arrive. */
function byNewton(a, b, whole, share, later, period) {
  let [w, part] = [a.w + share * (b.w - a.w), a.part + share * (b.part - a.part)];
  for (let i = 0; i < 40; i++) {
    const L = later((whole + part) * period)(w);
    const [size, angle] = [logGain(L), turned(Math.atan2(L.im, L.re) - Math.PI)];
    if (Math.hypot(size, angle) < 1e-11) return whole + part >= 0 ? part : null;
    const beside = later((whole + part + 1e-7) * period)(w);
    const bySize = (logGain(beside) - size) / 1e-7;
    const byAngle = turned(Math.atan2(beside.im, beside.re) - Math.PI - angle) / 1e-7;
    const turn = (L.re * L.dim - L.im * L.dre) / (L.re * L.re + L.im * L.im);
    const area = gainSlope(L) * byAngle - turn * bySize;
    w -= (size * byAngle - angle * bySize) / area;
    part -= (angle * gainSlope(L) - size * turn) / area;
    const near = Math.abs(part - a.part) < 2 / PARTS + Math.abs(b.part - a.part);
    if (!(w > 0) || !near) return null;
  }
  return null;
}

/** The least delay [s] at which a root is at -1, where L is real. */
function atTheEnd(end, later, parts, period, crossing) {
  const height = (part) => later(part * period)(end).re;
  const edges = [...parts, 1];
  let best = Infinity;
  for (const whole of [0, 1]) {
    const f = (part) => 1 + (whole ? -1 : 1) * height(part);
    for (let i = 1; i < edges.length; i++) {
      if (f(edges[i - 1]) > 0 === f(edges[i]) > 0) continue;
      best = Math.min(best, (whole + crossing(f, edges[i - 1], edges[i])) * period);
    }
  }
  return best;
}

// A robot before its controllers, as they sample it: what each command does to what is measured.
//
//   x_(j+1) = A x_j + B f_j in a period's n physics steps, A = Q U Q^H, f_j the mean forces,
//   (z - U^n) X(z) = sum_j U^(n-1-j) B F_j(z) u(z),
//
// with F_j(z) of each joint's held, delayed command behind its actuator, exactly.

import { instant, power, quotient, servos, times } from "./robot_servo.js";

// Answers to forces that are kept: so many points, of periods of so many physics steps.
const [MOST_KEPT, MOST_KEPT_STEPS] = [800, 4];

/** Complex matrix of `rows` times `columns` from base64 of float64, real part then imaginary. */
export function decoded(text, rows, columns) {
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  const values = new Float64Array(bytes.buffer);
  const size = rows * columns;
  return { rows, columns, re: values.slice(0, size), im: values.slice(size) };
}

const blank = (rows, columns) => ({
  rows,
  columns,
  re: new Float64Array(rows * columns),
  im: new Float64Array(rows * columns),
});

function product(a, b) {
  const found = blank(a.rows, b.columns);
  const n = b.columns;
  for (let i = 0; i < a.rows; i++) addRows(found, i * n, a, i * a.columns, b, 0, a.columns);
  return found;
}

/**
 * A row of `to` more by `count` numbers of `A`, from a place on, times rows of `from`, from a row on:
 * two rows at once, and without arrays in the loop: most time of a page goes by here.
 */
function addRows(to, row, A, place, from, first, count) {
  const n = to.columns;
  const { re: tr, im: ti } = to;
  const { re: ar, im: ai } = A;
  const { re: fr, im: fi } = from;
  for (let k = 0; k < count; k += 2) {
    const at = place + k;
    const more = k + 1 < count;
    const a = ar[at];
    const b = ai[at];
    const c = more ? ar[at + 1] : 0;
    const d = more ? ai[at + 1] : 0;
    const there = (first + k) * n;
    for (let j = 0, u = row, v = there, w = more ? v + n : v; j < n; j++, u++, v++, w++) {
      const e = fr[v];
      const f = fi[v];
      const g = fr[w];
      const h = fi[w];
      tr[u] += a * e - b * f + c * g - d * h;
      ti[u] += a * f + b * e + c * h + d * g;
    }
  }
}

/**
 * A robot opened at its controllers.
 *
 * `plant` as the page's data have it, decoded; `drives` arrays over the joints by parameter;
 * `differenced`: the controllers see differenced positions. Gives `respond(zr, zi)`, {q, v}: the
 * measured positions and velocities per command, `again` the same from
 * what is kept, `moved` and `speed` those at the ticks; `poles` of
 * the robot and its drives as {re, im}, `hidden` those that no command reaches; `period`, `joints`, and `whole`, the longest delay in
 * periods.
 */
export function openRobot(plant, drives, differenced) {
  const { step, substeps, inputs, outputs } = plant;
  const [m, n] = [inputs.columns, inputs.rows];
  const period = step * substeps;
  const { powers, whole, within } = overPeriod(plant);
  const forces = servos(drives, m, period, substeps);
  const sensed = drives.measurement_delay.map((delay) => instant(delay, period, step, substeps));
  const seen = sensed.some((one) => one !== null) ? within() : null;
  const filters = drives.velocity_filter.map((cutoff) => Math.exp(-cutoff * period));

  const respond = (zr, zi) => answer(forces(zr, zi), zr, zi);

  /** As `respond`, from answers to forces that are kept, for points that are asked for again. */
  function again(zr, zi) {
    if (substeps > MOST_KEPT_STEPS) return respond(zr, zi);
    const F = forces(zr, zi);
    const each = keptAnswers(plant, drives, differenced, answer, zr, zi);
    const found = { q: blank(m, m), v: blank(m, m) };
    for (const name of ["q", "v"]) {
      const own = Object.assign(found[name], { n: m });
      each.forEach((one, j) => addColumns(own, one[name], F, j));
    }
    return found;
  }

  function answer(F, zr, zi) {
    const X = blank(n, m);
    for (let j = 0; j < substeps; j++) addColumns(X, powers[substeps - 1 - j], F, j);
    solve(whole, X, zr, zi);
    const ticks = product(outputs, X);
    const [q, v] = [part(ticks, 0, m), part(ticks, 1, m)];
    const found = { q, v, moved: q, speed: v };
    if (seen || differenced) Object.assign(found, { q: copied(q), v: copied(v) });
    if (seen) measureLate(found, X, F, [zr, zi]);
    if (differenced) difference(found, zr, zi);
    return found;
  }

  function measureLate(found, X, F, z) {
    const rows = new Map();
    const after = (steps) => {
      if (!rows.has(steps)) rows.set(steps, seen(steps, X, F));
      return rows.get(steps);
    };
    sensed.forEach((one, i) => {
      if (one === null) return;
      const [lr, li] = power(quotient([1, 0], z), one.whole + 1);
      const [before, then] = [after(one.index), after(one.index + 1)];
      const { s } = one;
      const rise = s * s * (3 - 2 * s);
      const [b0, b1] = [step * s * (1 - s) * (1 - s), -step * s * s * (1 - s)];
      const position = (of, at, speed) =>
        (1 - rise) * before[of][at] + rise * then[of][at] + b0 * before[of][speed] + b1 * then[of][speed];
      const rate = (of, speed) => (1 - s) * before[of][speed] + s * then[of][speed];
      for (let at = i * m, speed = (m + i) * m; at < (i + 1) * m; at++, speed++) {
        const [x, y] = [position("re", at, speed), position("im", at, speed)];
        const [u, w] = [rate("re", speed), rate("im", speed)];
        found.q.re[at] = lr * x - li * y;
        found.q.im[at] = lr * y + li * x;
        found.v.re[at] = lr * u - li * w;
        found.v.im[at] = lr * w + li * u;
      }
    });
  }

  function difference(found, zr, zi) {
    const back = quotient([1, 0], [zr, zi]);
    filters.forEach((pole, i) => {
      const gain = (1 - pole) / period;
      const rate = quotient(
        [gain * (1 - back[0]), -gain * back[1]],
        [1 - pole * back[0], -pole * back[1]],
      );
      for (let at = i * m; at < (i + 1) * m; at++) {
        [found.v.re[at], found.v.im[at]] = times(rate, [found.q.re[at], found.q.im[at]]);
      }
    });
  }

  const poles = [];
  for (let i = 0; i < n; i++) poles.push({ re: whole.re[i * (n + 1)], im: whole.im[i * (n + 1)] });
  poles.push(...drivePoles(drives, filters, period, differenced));
  const slow = Math.max(...drives.delay.map((d, i) => d + drives.output_delay[i]));
  const delays = slow + Math.max(...drives.measurement_delay);
  const hidden = Array.from(plant.hidden.re, (re, i) => power([re, plant.hidden.im[i]], substeps)).map(
    ([re, im]) => ({ re, im }),
  );
  const later = (extra) =>
    openRobot(plant, { ...drives, delay: drives.delay.map((own) => own + extra) }, differenced);
  return { respond, again, later, joints: m, period, poles, hidden, drives, delays: delays / period };
}

/** The columns of `to` more by those of `from` times the forces of their joints in step j. */
function addColumns(to, from, F, j) {
  const m = to.columns;
  const { re: tr, im: ti } = to;
  const { re, im } = from;
  for (let k = 0; k < m; k++) {
    const [fr, fi] = F[k][j];
    for (let at = k; at < tr.length; at += m) {
      tr[at] += re[at] * fr - im[at] * fi;
      ti[at] += re[at] * fi + im[at] * fr;
    }
  }
}

const answers = new WeakMap();

/** What forces of 1 in each physics step do at a point, whatever the actuators and their delays. */
function keptAnswers(plant, drives, differenced, answer, zr, zi) {
  const sensing = `${differenced} ${drives.measurement_delay} ${drives.velocity_filter}`;
  if (answers.get(plant)?.sensing !== sensing) answers.set(plant, { sensing, at: new Map() });
  const { at } = answers.get(plant);
  const key = `${zr} ${zi}`;
  if (!at.has(key)) {
    if (at.size >= MOST_KEPT) at.clear();
    const steps = Array.from({ length: plant.substeps }, (_, j) => j);
    const alone = (j) => steps.map((i) => [i === j ? 1 : 0, 0]);
    at.set(
      key,
      steps.map((j) => answer(drives.delay.map(() => alone(j)), zr, zi)),
    );
  }
  return at.get(key);
}

const known = new WeakMap();

/** U^j Q^H B of every physics step j, U^n, and `rowsWithin` if asked; computed once for a plant. */
function overPeriod(plant) {
  if (!known.has(plant)) {
    const { triangular, inputs, substeps } = plant;
    const powers = [inputs];
    let whole = triangular;
    for (let j = 1; j < substeps; j++) {
      powers.push(product(triangular, powers[j - 1]));
      whole = product(triangular, whole);
    }
    let rows = null;
    const within = () => (rows ??= rowsWithin(plant, powers));
    known.set(plant, { powers, whole, within });
  }
  return known.get(plant);
}

/** Roots of the actuators and the filters over a period, those at 0 left out. */
function drivePoles(drives, filters, period, differenced) {
  const found = differenced ? filters.filter((x) => x > 0).map((re) => ({ re, im: 0 })) : [];
  drives.wn.forEach((wn, i) => {
    if (wn === Infinity) return;
    const [x, zeta] = [wn * period, drives.zeta[i]];
    const apart = x * Math.sqrt(Math.abs(zeta * zeta - 1));
    for (const sign of [-1, 1]) {
      const size = Math.exp(-zeta * x + (zeta > 1 ? sign * apart : 0));
      const angle = zeta > 1 ? 0 : sign * apart;
      found.push({ re: size * Math.cos(angle), im: size * Math.sin(angle) });
    }
  });
  return found;
}

const copied = ({ n, re, im }) => ({ n, re: re.slice(), im: im.slice() });

const part = (rows, which, m) => ({
  n: m,
  re: rows.re.slice(which * m * m, (which + 1) * m * m),
  im: rows.im.slice(which * m * m, (which + 1) * m * m),
});

/** Positions and velocities of the joints after some physics steps of a period, per command. */
function rowsWithin({ outputs, triangular, substeps }, powers) {
  const through = [outputs];
  for (let j = 0; j < substeps; j++) through.push(product(through[j], triangular));
  const pulses = powers.map((one) => product(outputs, one));
  const m = powers[0].columns;
  return (steps, X, F) => {
    const found = product(through[steps], X);
    for (let j = 0; j < steps; j++) addColumns(found, pulses[steps - 1 - j], F, j);
    return found;
  };
}

/** X <- (z - U)^-1 X of a triangular U. */
function solve(U, X, zr, zi) {
  const [n, m] = [X.rows, X.columns];
  const [re, im] = [X.re, X.im];
  for (let i = n - 1; i >= 0; i--) {
    addRows(X, i * m, U, i * (n + 1) + 1, X, i + 1, n - 1 - i);
    let [x, y] = [zr - U.re[i * (n + 1)], zi - U.im[i * (n + 1)]];
    // On a root, which a joint or an object that nothing holds has at 1 exactly.
    if (x === 0 && y === 0) x = 1e-16;
    const size = x * x + y * y;
    for (let j = i * m; j < (i + 1) * m; j++) {
      const [a, b] = [re[j], im[j]];
      re[j] = (a * x + b * y) / size;
      im[j] = (b * x - a * y) / size;
    }
  }
}

/** A plant of the page's data, ready for `openRobot`. */
export function plantOf(stored, joints) {
  const { states, step, substeps, inertias } = stored;
  const hidden = atob(stored.hidden).length / 16;
  return {
    step,
    substeps,
    inertias,
    triangular: decoded(stored.triangular, states, states),
    inputs: decoded(stored.inputs, states, joints),
    outputs: decoded(stored.outputs, 2 * joints, states),
    hidden: decoded(stored.hidden, 1, hidden),
  };
}

// The report of a robot: everything on the page follows gains, delay, actuators and control rate.

import { fill } from "./chart.js";
import { sliders } from "./controls.js";
import { diskMargin } from "./robot_disk.js";
import { glance } from "./robot_glance.js";
import { delayLimit, gainLimit, ranges } from "./robot_limits.js";
import { closing, responding } from "./robot_loop.js";
import * as margins from "./robot_margins.js";
import { openRobot, plantOf } from "./robot_response.js";
import { stepResponse, ticksOf } from "./robot_step.js";
import * as steps from "./robot_step_view.js";
import * as views from "./robot_views.js";
import * as words from "./robot_words.js";

const SETTLE_AFTER = 120;
const SPEAK_AFTER = 500;
// Of computing, between which the page answers [ms]: what 12 joints need at once, and the rest.
const AT_ONCE = 60;
const SLICE = 15;
// Columns of the map less one, for few and for many joints: powers of two.
const [COLUMNS, FEWER, MANY] = [32, 16, 14];
const FACTORS = [0.05, 50];

/** Start the part with its data, in the document or in a shadow root that has its elements. */
export function start(data, host) {
  const by = (id) => host.getElementById(id);
  const plants = new Map();
  const groups = Object.entries(data.groups);
  const kept = { open: null, coarse: null, map: null };
  let state = beginning(0);
  let window = windowOf(state);
  let asked = 0;
  let running = 0;
  let [busy, again] = [false, false];
  let place = null;
  let show = () => {};

  function beginning(loop) {
    const { drives, rate } = data.loops[loop];
    const factors = Object.fromEntries(
      groups.flatMap(([, __], i) => [
        [`kp_${i}`, 1],
        [`kd_${i}`, 1],
      ]),
    );
    const [wn, zeta, delay] = [drives.wn[0], drives.zeta[0], Math.min(...drives.delay)];
    return { loop, rate, gain_scale: 1, delay, wn, zeta, ...factors };
  }

  function windowOf({ delay }) {
    return { delay: [0, Math.max(0.02, 2.5 * delay)], factor: FACTORS };
  }

  /** The parameters of the joints at the point. */
  function drivesOf() {
    const own = data.loops[state.loop].drives;
    const later = state.delay - Math.min(...own.delay);
    const wn = own.wn.map((one) => moved(one, own.wn[0], state.wn));
    const zeta = own.zeta.map((one) => moved(one, own.zeta[0], state.zeta));
    const [kp, kd] = [own.kp, own.kd].map((gains) => gains.map((one) => one * state.gain_scale));
    groups.forEach(([, places], i) => {
      for (const joint of places) {
        kp[joint] *= state[`kp_${i}`];
        kd[joint] *= state[`kd_${i}`];
      }
    });
    return { ...own, wn, zeta, kp, kd, delay: own.delay.map((one) => one + later) };
  }

  function openAt(drives) {
    const key = `${state.loop} ${state.rate} ${drives.wn} ${drives.zeta} ${drives.delay}`;
    if (kept.open?.key !== key) {
      const number = data.loops[state.loop].plants[state.rate];
      if (!plants.has(number)) plants.set(number, plantOf(data.plants[number], data.joints.length));
      const plant = plants.get(number);
      const open = openRobot(plant, drives, data.velocity === "differenced");
      Object.assign(kept, { open: { key, open, plant }, coarse: null });
    }
    return kept.open;
  }

  function redraw() {
    asked = 0;
    drawMap();
    // Asked for again where nothing has moved, as by another width of the window.
    if (kept.settled?.key === JSON.stringify(state)) {
      kept.settled.draw();
      return;
    }
    kept.settled = null;
    running += 1;
    const drives = drivesOf();
    outdate(drives);
    by("robot-command").value = words.command(data, state, drives);
    by("robot-toml").value = words.toml(data, state, drives);
    // What moves faster than a robot with many joints is computed is skipped, not queued.
    again = busy;
    if (busy) return;
    busy = true;
    say(words.quick(null), null, false);
    const done = () => {
      busy = false;
      if (again) later();
      else settleSoon(drives);
    };
    work(quick(drives), done, AT_ONCE);
  }

  /** Nothing of before a move is left as if it were of now. */
  function outdate(drives) {
    for (const name of ["margins", "joints"]) views.waiting(by(`robot-${name}`));
    for (const name of ["sensitivity", "shape"]) fill(by(`robot-${name}-data`), () => ["…"]);
    by("robot-shape").classList.add("outdated");
    by("robot-shape-says").textContent = "…";
    steps.outdate(by);
    if (!kept.map || kept.map.key === mapKey(drives)) return;
    by("robot-map").classList.add("outdated");
    by("robot-drawing").textContent = "(of before the move)";
    fill(by("robot-map-data"), () => ["…"]);
  }

  /** Whether it is stable, and the singular values as a first picture. */
  function* quick(drives) {
    const began = performance.now();
    const { open } = openAt(drives);
    yield;
    kept.coarse ??= yield* responding(open, false);
    const { unstable, points } = yield* glance(kept.coarse, drives.kp, drives.kd);
    say(words.quick(unstable), unstable === null ? null : unstable === 0, false);
    views.drawSensitivities(by("robot-sensitivity"), points, open.period);
    performance.measure("redraw", { start: began, end: performance.now() });
  }

  function settleSoon(drives) {
    const own = running;
    const unmoved = () => own === running;
    setTimeout(() => work(settle(drives), () => {}, SLICE, unmoved), SETTLE_AFTER);
  }

  /** Run a generator in slices, for as long as it is wanted. */
  function work(steps, done, slice, wanted = () => true) {
    if (!wanted()) return;
    const until = performance.now() + slice;
    do {
      if (steps.next().done) {
        done();
        return;
      }
    } while (performance.now() < until);
    setTimeout(() => work(steps, done, slice, wanted), 0);
  }

  /** All numbers in full, a step after the other. */
  function* settle(drives) {
    const { open, plant } = openAt(drives);
    const known = yield* responding(open, true);
    const loop = yield* closing(known, drives.kp, drives.kd);
    const growth = yield* margins.growth(loop);
    yield;
    yield* margins.sharpen(loop, growth.roots);
    const found = { growth };
    for (const point of loop.points) {
      margins.withSensitivity(point);
      yield;
    }
    if (growth.stable) found.peaks = yield* margins.peaks(loop);
    found.up = yield* gainLimit(loop, true, growth.topples && !growth.shakes);
    found.down = yield* gainLimit(loop, false, growth.topples && !growth.shakes);
    if (!growth.shakes) found.later = yield* delayLimit(loop);
    yield;
    found.shape = shapeOf(loop, found, plant.inertias);
    const said = words.verdict(found, data.joints);
    views.showMargins(by("robot-margins"), words.rows(found, open.period));
    by("robot-shape-says").textContent = words.shapeSays(found);
    const points = margins.withSensitivities(loop);
    fill(by("robot-sensitivity-data"), () => [views.sensitivityTable(points, open.period)]);
    fill(by("robot-shape-data"), () => [views.shapeTable(data.joints, found.shape)]);
    const draw = () => {
      views.drawSensitivities(by("robot-sensitivity"), points, open.period);
      views.drawShape(by("robot-shape"), data.joints, found.shape);
      kept.settled?.drawStep?.();
      by("robot-shape").classList.remove("outdated");
    };
    draw();
    kept.settled = { key: JSON.stringify(state), draw, drives, found, plant };
    say(said, growth.stable, true);
    yield;
    yield* stepped();
    const joints = [];
    for (let i = 0; growth.stable && i < data.joints.length; i++) {
      joints.push(yield* margins.ofJoint(loop, i));
    }
    by("robot-joints").replaceChildren(views.jointTable(data, drives, joints, found.shape));
    if (growth.stable) {
      found.disk = yield* diskMargin(loop);
      views.showMargins(by("robot-margins"), words.rows(found, open.period));
    }
    by("robot-verdict").dataset.joints = "true";
    yield* map(drives);
  }

  /** The answer to a step of one joint's setpoint, of what has settled. */
  function* stepped() {
    const { drives, found, plant } = kept.settled;
    const which = steps.joint(by, found.shape);
    const ticks = ticksOf(found.growth, plant.step * plant.substeps);
    const differenced = data.velocity === "differenced";
    const answer = yield* stepResponse(plant, drives, differenced, which, ticks);
    kept.settled.drawStep = steps.show(by, data, which, answer);
  }

  /** Another joint steps: at once where all else has settled, else in its turn. */
  function stepOther() {
    if (!kept.settled?.drawStep) return;
    const own = running;
    steps.outdate(by);
    work(stepped(), () => {}, SLICE, () => own === running);
  }

  /** The motion in which the loop is lost first: by delay, else by gain; as it is, if it shakes. */
  function shapeOf(loop, { growth, later, up }, inertias) {
    if (growth.shakes) {
      const root = growth.roots.find(({ re, im }) => im > re);
      return margins.growingShape(loop, root, inertias);
    }
    if (later) return margins.lateShape(loop, later, inertias);
    if (up && up.t > 0) return margins.gainShape(loop, up, inertias);
    return null;
  }

  /** What the map is of: all but the point. */
  function mapKey(drives) {
    const base = (gains) => gains.map((k) => Math.fround(k / state.gain_scale));
    return `${state.loop} ${state.rate} ${drives.wn} ${drives.zeta} ${base(drives.kp)} ${base(drives.kd)} ${window.delay}`;
  }

  /** Which gains are stable over the delay, a column after the other between those that are there. */
  function* map(drives) {
    const base = { ...drives, kp: drives.kp.map((k) => k / state.gain_scale) };
    base.kd = drives.kd.map((k) => k / state.gain_scale);
    const key = mapKey(drives);
    if (kept.map?.key !== key) kept.map = { key, columns: [] };
    by("robot-map").classList.remove("outdated");
    const { columns } = kept.map;
    const parts = data.joints.length > MANY ? FEWER : COLUMNS;
    if (columns.length > parts) return;
    for (const i of inHalves(parts).slice(columns.length)) {
      const delay = (window.delay[1] * i) / parts;
      const open = openAt(drives).open.later(delay - state.delay);
      yield;
      const known = yield* responding(open, false);
      const loop = yield* closing(known, base.kp, base.kd);
      const found = [];
      for (const range of ranges(loop, window.factor[1])) {
        found.push(range);
        yield;
      }
      columns.push({ delay, ranges: found });
      const left = columns.length <= parts;
      const share = Math.round((100 * columns.length) / (parts + 1));
      by("robot-drawing").textContent = left ? `(drawing: ${share} %)` : "";
      drawMap();
      yield;
    }
    fill(by("robot-map-data"), () => [views.mapTable(inOrder(columns))]);
  }

  function drawMap() {
    const columns = inOrder(kept.map?.columns ?? []);
    place = views.drawMap(by("robot-map"), { window, columns, point: state, own: data.loops[state.loop] });
  }

  function say(text, stable, settled) {
    by("robot-verdict").textContent = text;
    Object.assign(by("robot-verdict").dataset, { stable, settled, joints: "false" });
    if (!settled) return;
    setTimeout(() => {
      if (by("robot-verdict").textContent === text) by("robot-spoken").textContent = text;
    }, SPEAK_AFTER);
  }

  const later = () => (asked ||= requestAnimationFrame(redraw));

  function changed(name, value) {
    state[name] = value;
    show(state);
    later();
  }

  function take(loop) {
    state = beginning(loop);
    window = windowOf(state);
    by("robot-rate").replaceChildren(
      ...Object.keys(data.loops[loop].plants)
        .sort((a, b) => a - b)
        .map((rate) => new Option(`${rate} Hz`, rate, false, Number(rate) === Number(state.rate))),
    );
    state.rate = by("robot-rate").value;
    const rows = words.controlRows(state, window, data.loops[loop].drives);
    by("robot-controls").replaceChildren();
    by("robot-groups").replaceChildren();
    const grouped = words.groupRows(groups, data.loops[loop].drives);
    by("robot-groups-head").hidden = grouped.length === 0;
    const shows = [
      sliders(by("robot-controls"), rows, changed),
      sliders(by("robot-groups"), grouped, changed),
    ];
    show = (values) => shows.forEach((one) => one(values));
    show(state);
    later();
  }

  steps.choices(by, data.joints, stepOther);
  data.loops.forEach(({ name }, i) => by("robot-loop").append(new Option(name, i)));
  by("robot-loop").addEventListener("change", () => take(Number(by("robot-loop").value)));
  by("robot-again").addEventListener("click", () => take(Number(by("robot-loop").value)));
  by("robot-rate").addEventListener("change", () => changed("rate", by("robot-rate").value));
  views.movable(
    by("robot-pad"),
    by("robot-map"),
    () => ({ window, place, state }),
    (delay, factor) => {
      Object.assign(state, { delay, gain_scale: factor });
      show(state);
      later();
    },
  );
  new ResizeObserver(later).observe(by("robot-pad"));
  take(0);
  redraw();
}

const inOrder = (columns) => columns.toSorted((a, b) => a.delay - b.delay);

/** 0 to a power of two: both ends, the middle, the middles between these, ... */
function inHalves(parts) {
  const found = [0, parts];
  for (let step = parts; step > 1; step /= 2) {
    for (let i = step / 2; i < parts; i += step) found.push(i);
  }
  return found;
}

/** A joint's parameter where the one of the first joint is moved: all in proportion. */
function moved(own, first, now) {
  if (now === Infinity || first === Infinity) return first === now ? own : now;
  return own === Infinity ? own : (own * now) / first;
}

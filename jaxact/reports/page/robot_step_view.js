// How the joints of a robot answer a small step of the setpoint of one: picture, words and table.

import { fill, frame, line, short, table } from "./chart.js";
import { spanOf } from "./log_view.js";

// Of the setpoint [rad or m].
const SIZE = 0.01;
const HEIGHT = 260;
const ROWS = 60;
// Of what moves less than this share of the step nothing is said.
const STILL = 1e-6;

/** Choices of the joint that steps, the first to shake at the top; `chosen` hears of a new one. */
export function choices(by, names, chosen) {
  const own = by("robot-step-joint");
  own.append(new Option("the joint that shakes first", ""), ...names.map((name, i) => new Option(name, i)));
  own.addEventListener("change", chosen);
}

/** The joint that is to step; `shape` of the motion that shakes first, null if there is none. */
export function joint(by, shape) {
  const chosen = by("robot-step-joint").value;
  if (chosen !== "") return Number(chosen);
  if (!shape) return 0;
  return shape.reduce((best, { share }, i) => (share > shape[best].share ? i : best), 0);
}

/** Nothing of before is left as if it were of now. */
export function outdate(by) {
  by("robot-step").classList.add("outdated");
  for (const name of ["says", "own", "other"]) by(`robot-step-${name}`).textContent = "…";
  fill(by("robot-step-data"), () => ["…"]);
}

/**
 * Show a step of joint `which`: `answer` {time, positions} of a unit step; `rotary` of each joint.
 * Gives what draws it again.
 */
export function show(by, { joints, rotary }, which, { time, positions }) {
  const unit = (i) => (rotary[i] ? "rad" : "m");
  const peak = (i) => positions[i].reduce((top, x) => Math.max(top, Math.abs(x)), 0);
  const others = joints.map((_, i) => i).filter((i) => i !== which);
  const other = others.reduce((a, b) => (a === null || peak(b) > peak(a) ? b : a), null);
  const moves = other !== null && peak(other) > STILL;
  const drawn = moves ? [which, other] : [which];
  const scaled = (i) => positions[i].map((x) => SIZE * x);
  const units = [...new Set(drawn.map(unit))].join(", ");
  const draw = () => {
    const goal = [SIZE, SIZE];
    const place = frame(by("robot-step"), {
      x: { domain: [0, time.at(-1)], log: false, label: "time [s]" },
      y: { domain: spanOf([0, SIZE, ...drawn.flatMap(scaled)]), log: false, label: `position [${units}]` },
      height: HEIGHT,
    });
    line(place, [0, time.at(-1)], goal, { class: "reference" });
    if (moves) line(place, time, scaled(other), { class: "sampled" });
    line(place, time, scaled(which), { class: "continuous" });
  };
  by("robot-step").classList.remove("outdated");
  by("robot-step-own").textContent = joints[which];
  by("robot-step-more").hidden = !moves;
  by("robot-step-other").textContent = moves ? joints[other] : "";
  const most = moves
    ? `; of the others ${joints[other]} moves most, by up to ${short(SIZE * peak(other), 3)} ${unit(other)}`
    : others.length
      ? "; no other joint moves"
      : "";
  by("robot-step-says").textContent =
    `A step of ${SIZE} ${unit(which)} of the setpoint of ${joints[which]}, of the sampled loop, ` +
    `linearised${most}`;
  fill(by("robot-step-data"), () => [stepTable(joints, unit, drawn, time, scaled)]);
  draw();
  return draw;
}

function stepTable(joints, unit, drawn, time, scaled) {
  const stride = Math.max(1, Math.ceil(time.length / ROWS));
  const kept = (values) => values.filter((_, i) => i % stride === 0);
  return table("Positions after the step", [
    { head: "time [s]", values: kept(time) },
    ...drawn.map((i) => ({ head: `${joints[i]} [${unit(i)}]`, values: kept(scaled(i)) })),
  ]);
}

// The report of tuned gains: what is certified, two pairs of gains beside each other, the front.

import { checkTable, showSentence } from "./certificate.js";
import { draw, fill, frame, line, short, table } from "./chart.js";
import * as views from "./curve_views.js";
import { frequencyGrid, responses } from "./frequencies.js";
import { continuousLoop, sampledLoop } from "./loops.js";
import { margins } from "./margins.js";
import { showMargins } from "./margins_table.js";
import { rightmostRoot } from "./roots.js";
import { stepResponse, ticksOf } from "./step_response.js";
import { command, gainUnits, verdict } from "./words.js";

const HEIGHT = 280;

/** Start the part with its data, in the document or in a shadow root that has its elements. */
export function start(data, host) {
  const by = (id) => host.getElementById(id);
  const [stiff, damping] = gainUnits(data.unit);
  const words = ({ kp, kd }) => `kp ${short(kp)} ${stiff}, kd ${short(kd)} ${damping}`;
  const sides = [
    ...data.sides,
    ...data.front.map((one) => ({ ...one, name: `Ms, Mt ≤ ${short(one.max_peak)}` })),
  ];
  const last = data.sides.length - 1;
  const chosen = () => ({
    left: sides[by("tuned-left").value],
    right: sides[by("tuned-right").value],
    parameters: data.loops[by("tuned-loop").value].parameters,
  });

  function found(parameters, { kp, kd }) {
    const loop = (data.sampled ? sampledLoop : continuousLoop)(parameters);
    const around = { kp: [kp / 10, kp * 10], kd: [kd / 10, kd * 10] };
    const grid = frequencyGrid(loop, around);
    const own = margins(loop, responses(loop, grid), kp, kd);
    const root = rightmostRoot(loop, kp, kd, grid);
    const step = stepResponse(parameters, kp, kd, ticksOf(parameters, root));
    return { margins: own, root, curves: views.curves(loop, kp, kd, own), step };
  }

  function redraw() {
    const { left, right, parameters } = chosen();
    const both = { left: found(parameters, left), right: found(parameters, right) };
    const of = (name) => ({ left: both.left[name], right: both.right[name] });
    views.drawStep(by("tuned-step"), of("step"));
    views.drawSensitivity(by("tuned-sensitivity"), of("curves"));
    showMargins(by("tuned-margins"), both);
    for (const [side, one] of [
      ["left", left],
      ["right", right],
    ]) {
      by(`${side}-head`).textContent = one.name;
      by(`${side}-name`).textContent = `${one.name}: ${words(one)}`;
    }
    by("tuned-says").textContent = `${right.name}. ${verdict({
      ...{ parameters, kp: right.kp, kd: right.kd, unit: data.unit },
      ...{ margins: both.right.margins, root: both.right.root, sampled: data.sampled },
    })}`;
    by("tuned-toml").value = `[gains]\nkp = ${right.kp}\nkd = ${right.kd}`;
    by("tuned-command").value = command(parameters, right.kp, right.kd, data.unit);
    fill(by("tuned-data"), () =>
      (sides.length === 1 ? ["right"] : ["left", "right"]).flatMap((side) => {
        const { name } = chosen()[side];
        return [views.curveTable(name, both[side].curves), views.stepTable(both[side].step, name)];
      }),
    );
    if (data.front.length) drawFront();
  }

  function drawFront() {
    const { value, unit, name } = data.objective;
    const all = [...data.front.map((one) => one.objective), value].filter((x) => x > 0);
    const peaks = data.front.map((one) => one.max_peak);
    const [least, most] = [peaks[0], peaks[peaks.length - 1]];
    const beside = 0.04 * (most - least || most);
    const place = frame(by("front"), {
      x: { domain: [least - beside, most + beside], log: false, label: "largest Ms and Mt allowed" },
      y: {
        domain: [Math.min(...all) / 1.2, 1.2 * Math.max(...all)],
        log: true,
        label: `${name}${unit === "1" ? "" : ` [${unit}]`}`,
      },
      height: HEIGHT,
    });
    const values = data.front.map((one) => one.objective);
    line(place, peaks, values, { class: "right" });
    data.front.forEach(({ max_peak: peak, objective, certified }, i) => {
      if (!(objective > 0)) return;
      const seen = Number(by("tuned-right").value) === data.sides.length + i;
      const at = { cx: place.x(peak), cy: place.y(objective), r: seen ? 8 : 5 };
      const dot = draw("circle", { class: `chosen${certified ? "" : " hollow"}`, ...at });
      dot.addEventListener("click", () => choose(data.sides.length + i));
      place.inside.append(dot);
    });
    fill(by("front-data"), () => [frontTable(data.front, { stiff, damping, name, unit })]);
  }

  function choose(index) {
    by("tuned-right").value = index;
    redraw();
  }

  showSentence(by("tuned-sentence"), data);
  if (data.checks.length) by("tuned-checks").append(checkTable(data));
  data.loops.forEach(({ name }, i) => by("tuned-loop").append(new Option(name, i)));
  sides.forEach(({ name }, i) => {
    by("tuned-left").append(new Option(name, i));
    by("tuned-right").append(new Option(name, i, i === last, i === last));
  });
  by("front-section").hidden = data.front.length === 0;
  if (sides.length === 1) {
    // Nothing was given to start from: there is nothing to compare with.
    by("compared-head").textContent = "What the gains do";
    for (const one of host.querySelectorAll(".of-two")) one.hidden = true;
    by("compared").classList.add("single");
  }
  for (const id of ["tuned-loop", "tuned-left", "tuned-right"]) {
    by(id).addEventListener("change", redraw);
  }
  new ResizeObserver(redraw).observe(by("tuned-sentence"));
  redraw();
}

function frontTable(front, { stiff, damping, name, unit }) {
  const column = (head, value) => ({ head, values: front.map(value) });
  return table("The front", [
    column("largest Ms and Mt allowed", (one) => one.max_peak),
    column(`kp [${stiff}]`, ({ kp }) => kp),
    column(`kd [${damping}]`, ({ kd }) => kd),
    column(`${name} [${unit}]`, ({ objective }) => objective ?? NaN),
    column("certified", ({ certified }) => (certified ? "yes" : "NO")),
  ]);
}

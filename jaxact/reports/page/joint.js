// The report of a joint: everything on the page follows the point and the sliders.

import { boundary } from "./boundary.js";
import { cellAt, cellKey, cellWords } from "./cells.js";
import { fill } from "./chart.js";
import { controls } from "./controls.js";
import * as views from "./curve_views.js";
import { frequencyGrid, responses } from "./frequencies.js";
import { continuousLoop, sampledLoop } from "./loops.js";
import { COARSE, drawMap, FINE, mapLayers, mapTable, movable } from "./map_view.js";
import { margins } from "./margins.js";
import { showMargins } from "./margins_table.js";
import { rightmostRoot } from "./roots.js";
import { stepResponse, ticksOf } from "./step_response.js";
import { command, toml, verdict } from "./words.js";

const SPEAK_AFTER = 500;
const SHARPEN_AFTER = 120;
const MAKE = { continuous: continuousLoop, sampled: sampledLoop };

/**
 * Start the part with its data, in the document or in a shadow root that has its elements.
 *
 * `drawn(values)` is called with all parameters when they have been drawn. Gives `set(values)`,
 * which moves to other ones, by short name.
 */
export function start(data, host, drawn = () => {}) {
  const by = (id) => host.getElementById(id);
  const { window, unit, loops } = data;
  const first = loops[data.start];
  const state = {
    parameters: { ...first.parameters },
    kp: first.parameters.kp,
    kd: first.parameters.kd,
  };
  let plants = null;
  let layers = null;
  let place = null;
  let asked = 0;
  let speaking = 0;
  let sharpening = 0;

  const kind = () => host.querySelector("input[name=kind]:checked").value;

  /** What depends on the plant alone is kept until a slider moves. */
  function plantOf(which) {
    if (!plants[which]) {
      const loop = MAKE[which](state.parameters);
      const grid = frequencyGrid(loop, window);
      const cached = responses(loop, grid);
      plants[which] = { loop, grid, cached };
    }
    return plants[which];
  }

  function forgetMap() {
    layers = null;
    clearTimeout(sharpening);
  }

  /** Lines of the delay margin are of continuous time: a sampled loop's takes too long for a map. */
  function offer(which) {
    const choice = by("quantity");
    const delay = choice.querySelector("option[value=delay_margin]");
    delay.disabled = which === "sampled";
    if (delay.disabled && delay.selected) {
      choice.value = "sensitivity_peak";
      forgetMap();
    }
  }

  /** The map, first of a few gains, and of many as soon as no slider moves any more. */
  function map() {
    const which = kind();
    offer(which);
    const { loop, cached } = plantOf(which);
    const quantity = by("quantity").value;
    plants[which].edges ??= boundary(loop, cached, window);
    layers ??= mapLayers(loop, cached, window, quantity, COARSE);
    place = drawMap(by("map"), {
      window,
      unit,
      layers,
      edges: plants[which].edges,
      points: data.points,
      point: { kp: state.kp, kd: state.kd },
      cells: cellsShown() ? data.cells : null,
      loop: Number(by("loop").value),
    });
    clearTimeout(sharpening);
    if (layers.count === FINE) return;
    sharpening = setTimeout(() => {
      layers = mapLayers(loop, cached, window, quantity, FINE);
      map();
    }, SHARPEN_AFTER);
  }

  function found(which) {
    const { loop, grid, cached } = plantOf(which);
    const own = margins(loop, cached, state.kp, state.kd);
    return { margins: own, root: rightmostRoot(loop, state.kp, state.kd, grid), loop };
  }

  function redraw() {
    asked = 0;
    const began = performance.now();
    plants ??= {};
    map();
    const both = { continuous: found("continuous"), sampled: found("sampled") };
    showMargins(by("margins"), both);
    say(both);
    pictures(both, plants[kind()].edges);
    performance.measure("redraw", { start: began, end: performance.now() });
    drawn({ ...state.parameters, kp: state.kp, kd: state.kd });
  }

  /** Cells are of a loop as it was simulated: not of one whose sliders were moved. */
  function cellsShown() {
    const simulated = loops[Number(by("loop").value)].parameters;
    const same = Object.keys(simulated).every(
      (name) => name === "kp" || name === "kd" || simulated[name] === state.parameters[name],
    );
    return Boolean(data.cells) && by("cells").checked && same;
  }

  /** What was simulated near the point, in words; "" where nothing was. */
  function cellSays() {
    const there = cellsShown();
    const loop = Number(by("loop").value);
    const words = there ? cellWords(cellAt(data.cells, loop, state), unit ?? "m") : "";
    by("cell-says").textContent = words;
    by("cell-says").hidden = by("cells-key").hidden = !there;
    if (there) {
      by("cells-key").replaceChildren(
        "simulated: ",
        ...cellKey(data.cells, loop).flatMap(({ text, kind }) => {
          const [entry, swatch] = [0, 1].map(() => document.createElement("span"));
          entry.className = "entry";
          swatch.className = `swatch ${kind}`;
          entry.append(swatch, ` ${text}`);
          return [entry, " "];
        }),
      );
    }
    return words;
  }

  function say(both) {
    const which = kind();
    const { margins: own, root } = both[which];
    const words = verdict({ ...state, unit, margins: own, root, sampled: which === "sampled" });
    by("verdict").textContent = words;
    by("verdict").dataset.stable = own.stable;
    clearTimeout(speaking);
    const spoken = `${words} ${cellSays()}`.trim();
    speaking = setTimeout(() => (by("spoken").textContent = spoken), SPEAK_AFTER);
    by("toml").value = toml(state.parameters, state.kp, state.kd, unit);
    by("command").value = command(state.parameters, state.kp, state.kd, unit);
  }

  function pictures(both, edges) {
    const lines = {};
    for (const which of ["continuous", "sampled"]) {
      lines[which] = views.curves(both[which].loop, state.kp, state.kd, both[which].margins);
    }
    const { margins: own, root } = both[kind()];
    views.drawBode(by("gain"), by("phase"), lines);
    views.drawNyquist(by("nyquist"), lines, own.stable ? own.sensitivity_peak : 0);
    views.drawSensitivity(by("sensitivity"), lines);
    const step = stepResponse(state.parameters, state.kp, state.kd, ticksOf(state.parameters, root));
    views.drawStep(by("step"), { sampled: step });
    fill(by("map-data"), () => [mapTable(edges, unit)]);
    fill(by("loop-data"), () =>
      Object.entries(lines).map(([name, one]) => views.curveTable(`The ${name} loop`, one)),
    );
    fill(by("step-data"), () => [views.stepTable(step)]);
  }

  const later = () => (asked ||= requestAnimationFrame(redraw));

  /** Move to other values by short name: gains, and what the loop is made of. */
  function set({ kp = state.kp, kd = state.kd, ...others }) {
    Object.assign(state, { kp, kd });
    const moved = Object.keys(others).some((name) => others[name] !== state.parameters[name]);
    Object.assign(state.parameters, others);
    if (moved) {
      plants = null;
      forgetMap();
    }
    show({ ...state.parameters, kp, kd });
    later();
  }

  const take = () => set(loops[Number(by("loop").value)].parameters);

  host.querySelector(
    `input[name=kind][value=${data.sampled ? "sampled" : "continuous"}]`,
  ).checked = true;
  const show = controls(by("controls"), first.parameters, window, unit, (name, value) =>
    set({ [name]: value }),
  );
  movable(
    by("pad"),
    by("map"),
    window,
    () => place,
    () => state,
    (kp, kd) => set({ kp, kd }),
  );
  loops.forEach(({ name }, i) =>
    by("loop").append(new Option(name, i, i === data.start, i === data.start)),
  );
  by("loop").addEventListener("change", take);
  by("again").addEventListener("click", take);
  for (const { name, kp, kd } of data.points) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = `go to ${name}`;
    button.addEventListener("click", () => set({ kp, kd }));
    by("points").append(button);
  }
  by("cells-choice").hidden = !data.cells;
  by("cells").addEventListener("change", later);
  for (const input of host.querySelectorAll("input[name=kind], #quantity")) {
    input.addEventListener("change", () => {
      forgetMap();
      later();
    });
  }
  new ResizeObserver(later).observe(by("pad"));
  show(first.parameters);
  redraw();
  return { set };
}

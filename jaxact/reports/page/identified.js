// The report of an identification: what was found, the logs over their simulation, how it was chosen.

import { fill, lines, short, table } from "./chart.js";
import { logView } from "./log_view.js";
import * as views from "./model_views.js";

/** Start the part with its data, in the document or in a shadow root that has its elements. */
export function start(data, host) {
  const by = (id) => host.getElementById(id);
  const logs = logView(by);
  let shown = data.drives[0];

  function show(drive) {
    shown = drive;
    by("found-sentence").textContent = drive.sentence;
    by("found-sentence").dataset.stable = drive.level !== "not good enough";
    lines(by("found-notes"), drive.notes);
    by("found-estimates").replaceChildren(estimates(drive));
    by("found-correlation").replaceChildren(...correlation(drive.correlation));
    by("logs-section").hidden = drive.logs.length === 0;
    if (drive.logs.length) logs.show(drive);
    pictures();
  }

  function pictures() {
    views.drawLadder(by("ladder"), shown);
    views.drawResponse(by("frequency-gain"), by("frequency-phase"), shown.response);
    views.drawAutocorrelation(by("white"), shown.autocorrelation);
    views.drawProfiles(by("profiles"), shown);
    fill(by("models-data"), () => views.modelTables(shown));
  }

  by("found-choice").hidden = data.drives.length < 2;
  data.drives.forEach(({ name }, i) => by("found-drive").append(new Option(name, i)));
  by("found-drive").addEventListener("change", () => show(data.drives[by("found-drive").value]));
  new ResizeObserver(() => {
    pictures();
    logs.redraw();
  }).observe(by("found-sentence"));
  show(shown);
}

function estimates({ model, estimates: found }) {
  const column = (head, value) => ({ head, values: found.map(value) });
  return table(`The chosen model: ${model}`, [
    column("number", ({ name, unit }) => (unit === "1" ? name : `${name} [${unit}]`)),
    column("value", ({ value }) => value),
    column("95 %, from", ({ low }) => low),
    column("to", ({ high }) => high),
    column("times the naive interval", (one) => one.wider_than_naive),
    column("known", ({ identified, reason }) => (identified ? "yes" : `NO: ${reason}`)),
  ]);
}

function correlation({ names, rows }) {
  if (names.length < 2) return [];
  const columns = names.map((head, i) => ({ head, values: rows[i].map((x) => short(x, 2)) }));
  return [table("Correlation of the numbers", [{ head: "number", values: names }, ...columns])];
}

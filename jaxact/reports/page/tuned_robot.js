// The report of a robot's tuned gains: what is certified, gains before and after, the front.

import { checkTable, showSentence } from "./certificate.js";
import { short, table } from "./chart.js";

/** Start the part with its data, in the document. */
export function start(data, host) {
  const by = (id) => host.getElementById(`tuned-robot-${id}`);
  const { checks, gains, front } = data;
  showSentence(by("sentence"), data);
  if (checks.length) by("checks").append(checkTable(data));
  by("gains").append(gainsTable(gains, data.units));
  if (front.points.length) by("front").append(frontTable(front));
  by("note").textContent = data.note;
  const empty = { checks: !checks.length, front: !front.points.length, note: !data.note };
  for (const [id, hidden] of Object.entries(empty)) by(id).hidden = hidden;
}

function gainsTable(gains, [ofKp, ofKd]) {
  const column = (head, value) => ({ head, values: gains.map(value) });
  const known = (value) => (value === null ? "several" : value);
  const before = gains.some((one) => one.before.length)
    ? ["kp", "kd"].map((name, i) => column(`${name} before`, (one) => known(one.before[i])))
    : [];
  return table(ofKp ? `Gains: kp in ${ofKp}, kd in ${ofKd}` : "Gains", [
    column("joints", ({ name }) => name),
    ...before,
    column("kp tuned", ({ kp }) => kp),
    column("kd tuned", ({ kd }) => kd),
  ]);
}

function frontTable({ head, points }) {
  const said = (text) => ({ true: "yes", false: "NO" })[text] ?? short(Number(text));
  return table(
    "The front of stiffness against robustness",
    head.map((name, i) => ({ head: name, values: points.map((row) => said(row[i])) })),
  );
}

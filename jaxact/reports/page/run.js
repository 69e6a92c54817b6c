// The report of a simulation: one joint of one loop over time, another loop beside it.

import { fill, frame, line, short, table } from "./chart.js";
import { spanOf } from "./log_view.js";

const ROWS = 60;
const HEIGHT = 240;
const NOTHING = "";

/** Start the part with its data, in the document. */
export function start(data, host) {
  const by = (id) => host.getElementById(`run-${id}`);
  const pictures = ["position", "velocity", "force"].filter((name) => name in data.units);

  function redraw() {
    const joint = by("joint").value;
    const loop = data.loops[by("loop").value];
    const beside = by("beside").value === NOTHING ? null : data.loops[by("beside").value];
    const [own, other] = [loop, beside].map((one) => one?.joints[joint]);
    const last = Math.max(...[own, other].map((one) => one?.time.at(-1) ?? 0));
    const x = { domain: [0, last], log: false, label: "time [s]" };
    for (const name of pictures) {
      const more = name === "position" ? own.setpoint : [];
      const seen = [...own[name], ...(other?.[name] ?? []), ...more];
      const y = { domain: spanOf(seen), log: false, label: `${name} [${data.units[name]}]` };
      const place = frame(by(name), { x, y, height: HEIGHT });
      if (name === "position") line(place, own.time, own.setpoint, { class: "measured" });
      if (other) line(place, other.time, other[name], { class: "continuous" });
      line(place, own.time, own[name], { class: "sampled" });
    }
    by("name").textContent = loop.name;
    by("other").hidden = !beside;
    by("other-name").textContent = beside?.name ?? "";
    say(loop, own);
    fill(by("data"), () =>
      [loop, beside].filter((one) => one).map((one) => over(one.name, one.joints[joint])),
    );
  }

  function say({ name, verdict, says }, { position, setpoint }) {
    const largest = Math.max(...position.map((value, i) => Math.abs(value - setpoint[i])));
    const which = data.joints.length === 1 ? "The joint" : data.joints[by("joint").value];
    by("verdict").textContent =
      `${name}: ${verdict}${says ? `: ${says}` : ""}. ${which} is at most ` +
      `${short(largest, 3)} ${data.units.position} from its setpoint, as far as it is drawn.`;
    by("verdict").dataset.stable = verdict === "stable";
  }

  function over(name, joint) {
    const stride = Math.max(1, Math.ceil(joint.time.length / ROWS));
    const every = (values) => values.filter((_, i) => i % stride === 0);
    return table(`${name}: one joint over time`, [
      { head: "time [s]", values: every(joint.time) },
      ...["setpoint", ...pictures].map((signal) => ({
        head: `${signal} [${data.units[signal]}]`,
        values: every(joint[signal]),
      })),
    ]);
  }

  const named = data.loops.map(({ name, verdict }, i) => [`${name} (${verdict})`, i]);
  by("loop").append(...named.map((one) => new Option(...one)));
  by("beside").append(new Option("nothing", NOTHING), ...named.map((one) => new Option(...one)));
  by("beside").value = data.beside ?? NOTHING;
  data.joints.forEach((name, i) => by("joint").append(new Option(name, i)));
  if (data.head) by("head").textContent = data.head;
  // Nothing to choose from.
  for (const id of ["loop", "beside"]) by(id).parentElement.hidden = data.loops.length === 1;
  by("joint").parentElement.hidden = data.joints.length === 1;
  for (const name of ["position", "velocity", "force"]) {
    by(name).parentElement.hidden = !pictures.includes(name);
  }
  for (const id of ["loop", "beside", "joint"]) by(id).addEventListener("change", redraw);
  new ResizeObserver(redraw).observe(by("position").parentElement);
  redraw();
}

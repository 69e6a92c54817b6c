// The joint's part in a notebook: its point and its parameters are those of a model in Python.

import { start } from "./joint.js";
import { read, wire } from "./main.js";

const toPython = (value) => (value === Infinity ? "inf" : value);
const fromPython = (value) => (value === "inf" ? Infinity : value);

/** Draw into `el`; `content` is the part's style and sections. Gives what ends it. */
export function render({ model, el }, content) {
  const host = document.createElement("div");
  el.append(host);
  // Ids and styles are the widget's own, however many of them a notebook has.
  const root = host.attachShadow({ mode: "open" });
  root.innerHTML = content;
  const names = model.get("_names");
  const { set } = start(read(model.get("_data")), root, drawn);
  wire(root);
  const follow = () =>
    set(Object.fromEntries(names.map((name) => [name, fromPython(model.get(name))])));
  for (const name of names) model.on(`change:${name}`, follow);
  follow();

  function drawn(values) {
    const moved = names.filter((name) => fromPython(model.get(name)) !== values[name]);
    for (const name of moved) model.set(name, toPython(values[name]));
    if (moved.length) model.save_changes();
  }

  return () => names.forEach((name) => model.off(`change:${name}`, follow));
}

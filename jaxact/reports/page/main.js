// The page: its data, what starts its parts, and what all of them have: tables and copy buttons.

/** Data as it was embedded, infinity as it was meant. */
export const read = (text) =>
  JSON.parse(text, (_, value) => (value === "inf" ? Infinity : value));

/** Start every part of the page with its own data; `starts` are functions by the part's name. */
export function begin(starts) {
  const data = read(document.getElementById("data").textContent);
  for (const [name, start] of Object.entries(starts)) start(data[name], document);
  wire(document);
}

/** Tables are made when they are opened, and buttons copy the text that they belong to. */
export function wire(root) {
  for (const details of root.querySelectorAll("details.data")) {
    details.addEventListener("toggle", () => details.open && details.refill?.());
  }
  for (const button of root.querySelectorAll("button.copy")) {
    button.addEventListener("click", () => copy(root.getElementById(button.dataset.of), button));
  }
}

/** Copy a text, where the browser lets the page; else select it. */
async function copy(area, button) {
  if (area.select) area.select();
  else getSelection().selectAllChildren(area);
  const done = await navigator.clipboard?.writeText(area.value ?? area.textContent).then(
    () => true,
    () => false,
  );
  button.textContent = done ? "copied" : "selected: press Ctrl+C";
}

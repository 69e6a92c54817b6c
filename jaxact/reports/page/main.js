// The page: its data, and what starts it.

import { start } from "./joint.js";

start(
  JSON.parse(document.getElementById("data").textContent, (_, value) =>
    value === "inf" ? Infinity : value,
  ),
);

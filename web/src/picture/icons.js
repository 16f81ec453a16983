/** Drawings on the buttons of the picture: lines on a square of 24. */

import {addDrawing} from "../dom.js";

const LINES = {
  home: ["M4 9V5a1 1 0 0 1 1-1h4", "M15 4h4a1 1 0 0 1 1 1v4", "M20 15v4a1 1 0 0 1-1 1h-4", "M9 20H5a1 1 0 0 1-1-1v-4", "M12 8.2l3.4 1.9v3.8L12 15.8l-3.4-1.9v-3.8z"],
  front: ["M12 3l8 4.5v9L12 21l-8-4.5v-9z", "M12 12l8-4.5", "M12 12v9", "M12 12L4 7.5", "M6.2 10.6v4.8M8.2 11.8v4.6M10 12.8v4.6"],
  side: ["M12 3l8 4.5v9L12 21l-8-4.5v-9z", "M12 12l8-4.5", "M12 12v9", "M12 12L4 7.5", "M17.8 10.6v4.8M15.8 11.8v4.6M14 12.8v4.6"],
  top: ["M12 3l8 4.5v9L12 21l-8-4.5v-9z", "M12 12l8-4.5", "M12 12v9", "M12 12L4 7.5", "M9 7.5h6M10.5 6h3M10.5 9h3"],
  tool: ["M12 3v5", "M12 16v5", "M3 12h5", "M16 12h5", "M12 12m-4.5 0a4.5 4.5 0 1 0 9 0a4.5 4.5 0 1 0-9 0", "M12 11.9v.2"],
  turn: ["M19.5 12a7.5 7.5 0 1 1-2.4-5.5", "M19.8 3v4.2h-4.2", "M12 9v3.2l2.2 1.4"],
  all: ["M4 5h7v14H4z", "M13 5h7v14h-7z"],
};

/** Draw one of them on a button. */
export function drawIcon(button, what) {
  const drawing = addDrawing(button, "svg", {viewBox: "0 0 24 24", "aria-hidden": "true"});
  for (const line of LINES[what]) addDrawing(drawing, "path", {d: line});
}

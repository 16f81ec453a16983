/** Words in the picture: which have room, and their elements above the canvas. Words are never drawn on each other. */
import {add, setText} from "../dom.js";

/** Free space around each [px]. */
const GAP = 3;
/** Distance from the point that it is of [px]. */
const ABOVE = 10;

const overlap = (a, b) => a.x < b.x + b.width + GAP && b.x < a.x + a.width + GAP && a.y < b.y + b.height + GAP && b.y < a.y + a.height + GAP;

/**
 * Return the labels that have room, each {...label, left, top}: the more important first, above its point, else below
 * it or beside it, within the picture. Pure.
 *
 * @param {{x: number, y: number, width: number, height: number, rank: number}[]} labels place of the point, size [px]
 * @param {number} width, height of the picture [px]
 * @param {{x: number, y: number, width: number, height: number}[]} taken where nothing may stand
 */
export function placed(labels, width, height, taken = []) {
  const boxes = [...taken];
  const found = [];
  for (const label of [...labels].sort((one, other) => other.rank - one.rank)) {
    const {x, y} = label;
    if (!(x >= 0 && x <= width && y >= 0 && y <= height)) continue;
    const [middle, level] = [x - label.width / 2, y - label.height / 2];
    for (const [left, top] of [[middle, y - label.height - ABOVE], [middle, y + ABOVE], [x + ABOVE, level], [x - label.width - ABOVE, level]]) {
      const box = {x: left, y: top, width: label.width, height: label.height};
      if (left < 0 || top < 0 || left + label.width > width || top + label.height > height) continue;
      if (boxes.some((each) => overlap(each, box))) continue;
      boxes.push(box);
      found.push({...label, left, top});
      break;
    }
  }
  return found;
}

/** About how large a text is [px]: to ask the browser for each would have it lay out the page at each frame. */
export function sizeOf(text) {
  return {width: 8.4 * text.length + 16, height: 22};
}

/**
 * Make the labels of a robot's part of the picture.
 *
 * @returns {(labels: {text: string, kind: string, x: number, y: number, rank: number}[], width: number, height: number,
 *   taken: object[]) => string[]} shows those that have room, and returns their texts
 */
export function makeLabels(overlay) {
  const layer = add(overlay, "div", {className: "labels", "aria-hidden": "true"});
  const elements = [];
  return (labels, width, height, taken) => {
    const shown = placed(labels.map((label) => ({...label, ...sizeOf(label.text)})), width, height, taken);
    while (elements.length < shown.length) elements.push(add(layer, "span"));
    elements.forEach((element, k) => {
      element.hidden = k >= shown.length;
      if (element.hidden) return;
      const {text, kind, left, top, width: wide} = shown[k];
      setText(element, text);
      element.className = `label label-${kind}`;
      element.style.setProperty("width", `${wide}px`);
      element.style.setProperty("transform", `translate(${Math.round(left)}px, ${Math.round(top)}px)`);
    });
    return shown.map(({text}) => text);
  };
}

/**
 * Curves of the last ten minutes: joint errors, round trip, late replies, with faults as marks; export as CSV.
 *
 * Samples are taken whether the panel is open or not; it draws twice a second, and only while somebody can see it.
 */
import {add, button, clear, setText} from "../dom.js";
import {csv} from "../plots/csv.js";
import {axis, decimals, firstValue, gapColumns, spans} from "../plots/curve.js";
import {History, WINDOW_S} from "../plots/history.js";

const DRAW_EVERY = 500;
/** Height of a plot, margins [CSS px]. */
const HEIGHT = 150;
const LEFT = 46;
const BOTTOM = 18;
const TOP = 8;
/** A line is broken where nothing was known for so long [s]. */
const GAP_S = 2;
/** What is older is not told as the present value [s]. */
const PRESENT_S = 1;
const MINUTE = 60;
/** Most robots have six joints, with a track seven. */
const COLOURS = 8;
/** Newest faults that stand below the plots in words. */
const TOLD = 20;

/**
 * Make the panel.
 *
 * @param {Element} parent
 * @param {object} store see store.js
 * @param {object} connection see connection.js
 * @param {Function} texts see texts.js
 * @param {object} [means] for tests: `now()` [s], `isSeen()`, `save(name, text)`
 */
export function make(parent, store, connection, texts, means = {}) {
  const {
    now = () => performance.now() / 1000,
    isSeen = () => (parent.tab?.isOpen() ?? true) && !parent.ownerDocument.hidden,
    save = saveFile,
  } = means;
  const histories = new Map();
  const hidden = new Set();
  let low = new Float32Array(0);
  let high = new Float32Array(0);
  let shownHistory = null;
  let shownMark = -1;

  const empty = add(parent, "p", {className: "plots-empty", role: "status", text: texts("plots.empty")});
  const inside = add(parent, "div", {className: "plots", hidden: true});
  const legend = add(inside, "div", {className: "plots-legend", role: "group", "aria-label": texts("plots.joints")});
  const errors = makePlot(texts("plots.errors"), "°");
  const track = makePlot(texts("plots.errors_linear"), "mm");
  const trip = makePlot(texts("plots.round_trip"), "ms");
  const late = makePlot(texts("plots.late"), "");
  const faults = add(inside, "div", {className: "plots-faults"});
  add(faults, "h3", {text: texts("plots.faults")});
  const noFault = add(faults, "p", {text: texts("plots.no_fault")});
  const list = add(faults, "ol", {className: "plots-fault-list"});
  button(inside, texts("plots.export"), onExport);

  function makePlot(title, unit) {
    const figure = add(inside, "figure", {className: "plot"});
    const head = add(figure, "figcaption");
    add(head, "span", {className: "plot-title", text: unit === "" ? title : `${title} [${unit}]`});
    const value = add(head, "span", {className: "plot-value"});
    const canvas = add(figure, "canvas", {role: "img", "aria-label": title});
    return {figure, canvas, value, title, unit};
  }

  // -- samples

  function history(robot) {
    return histories.get(robot) ?? null;
  }

  function onView(robot, view) {
    if (view === null) return;
    let mine = history(robot);
    if (mine === null || !mine.fits(view)) {
      mine = new History(view.joints.names, view.joints.types);
      histories.set(robot, mine);
    }
    mine.take(now(), view);
    mine.heard(now(), view.online, "");
  }

  // -- drawing

  function draw() {
    const mine = history(store.selected);
    empty.hidden = mine !== null;
    inside.hidden = mine === null;
    if (mine === null) return;
    if (shownHistory !== mine) showLegend(mine);
    const end = now();
    const joints = (unit) => mine.names.map((_, joint) => joint).filter((joint) => mine.unit(joint) === unit);
    drawErrors(errors, mine, joints("°"), end);
    drawErrors(track, mine, joints("mm"), end);
    drawOne(trip, mine, mine.roundTrip, end, 0, 1);
    const base = firstValue(mine.ring, mine.late, end - WINDOW_S);
    drawOne(late, mine, mine.late, end, Number.isNaN(base) ? 0 : base, 5);
    showFaults(mine, end);
  }

  function drawErrors(plot, mine, joints, end) {
    plot.figure.hidden = joints.length === 0;
    if (plot.figure.hidden) return;
    const visible = joints.filter((joint) => !hidden.has(joint));
    const view = store.robot(store.selected)?.view;
    const threshold = view?.sync?.threshold ?? [];
    const bounds = visible.map((joint) => threshold[joint]).filter((value) => typeof value === "number");
    const bound = bounds.length > 0 ? mine.shown(joints[0], Math.min(...bounds)) : NaN;
    const pen = begin(plot, end);
    if (pen === null) return;
    let largest = Number.isNaN(bound) ? 0 : bound;
    for (const joint of visible) largest = Math.max(largest, spans(mine.ring, joint, end - WINDOW_S, end, low, high));
    const scale = grid(pen, axis(largest));
    if (!Number.isNaN(bound)) boundLine(pen, scale(bound));
    for (const joint of visible) {
      spans(mine.ring, joint, end - WINDOW_S, end, low, high);
      curve(pen, scale, 0, pen.colour(`--curve-${(joint % COLOURS) + 1}`));
    }
    marks(pen, mine, end);
    const newest = visible.map((joint) => newestValue(mine, joint, end)).filter((value) => !Number.isNaN(value));
    const value = Math.max(...newest).toFixed(3);
    const text = newest.length === 0 ? texts("plots.unknown") : texts("plots.largest", {value, unit: plot.unit});
    label(plot, Number.isNaN(bound) ? text : `${text}, ${texts("plots.bound", {value: bound.toFixed(2), unit: plot.unit})}`);
  }

  function drawOne(plot, mine, column, end, base, smallest) {
    const pen = begin(plot, end);
    if (pen === null) return;
    const largest = spans(mine.ring, column, end - WINDOW_S, end, low, high) - base;
    const scale = grid(pen, axis(largest, smallest));
    curve(pen, scale, base, pen.colour("--curve-1"));
    marks(pen, mine, end);
    const value = newestValue(mine, column, end) - base;
    const unit = plot.unit === "" ? "" : ` ${plot.unit}`;
    label(plot, Number.isNaN(value) ? texts("plots.unknown") : `${value.toFixed(plot.unit === "" ? 0 : 1)}${unit}`);
  }

  /** The present value; what was heard a while ago is not the present. */
  function newestValue(mine, column, end) {
    const newest = mine.ring.size - 1;
    return newest < 0 || end - mine.ring.time(newest) > PRESENT_S ? NaN : mine.ring.value(newest, column);
  }

  function label(plot, text) {
    setText(plot.value, text);
    plot.canvas.setAttribute("aria-label", `${plot.title}: ${text}`);
  }

  /** Fit the canvas to the screen's pixels; returns what is needed to draw in it, null where nothing can be. */
  function begin(plot, end) {
    const {canvas} = plot;
    const width = canvas.clientWidth;
    const context = width > LEFT + 20 ? canvas.getContext("2d") : null;
    if (context === null) return null;
    const ratio = globalThis.devicePixelRatio ?? 1;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(HEIGHT * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(HEIGHT * ratio);
    }
    const columns = Math.floor(width - LEFT);
    if (low.length !== columns) {
      low = new Float32Array(columns);
      high = new Float32Array(columns);
    }
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, HEIGHT);
    context.font = "12px system-ui, sans-serif";
    const style = getComputedStyle(canvas);
    return {context, columns, end, colour: (name) => style.getPropertyValue(name).trim() || style.color, ink: style.color};
  }

  /** Draw axes; returns from a value to its height in the picture. */
  function grid({context, columns, colour, ink}, {step, top}) {
    const height = HEIGHT - TOP - BOTTOM;
    const scale = (value) => TOP + height * (1 - value / top);
    context.lineWidth = 1;
    context.strokeStyle = colour("--line");
    context.fillStyle = ink;
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (let value = 0; value <= top + step / 2; value += step) {
      const y = Math.round(scale(value)) + 0.5;
      context.beginPath();
      context.moveTo(LEFT, y);
      context.lineTo(LEFT + columns, y);
      context.stroke();
      context.fillText(value.toFixed(decimals(step)), LEFT - 6, y);
    }
    context.textBaseline = "alphabetic";
    const every = columns > 400 ? 2 : 5;
    for (let minutes = WINDOW_S / MINUTE; minutes >= 0; minutes -= every) {
      const x = LEFT + columns * (1 - (minutes * MINUTE) / WINDOW_S);
      context.textAlign = minutes === 0 ? "right" : minutes === WINDOW_S / MINUTE ? "left" : "center";
      context.fillText(minutes === 0 ? texts("plots.now") : texts("plots.minutes", {minutes}), x, HEIGHT - 4);
    }
    return scale;
  }

  function boundLine({context, columns, colour}, y) {
    context.strokeStyle = colour("--bad");
    context.setLineDash([5, 4]);
    context.beginPath();
    context.moveTo(LEFT, y);
    context.lineTo(LEFT + columns, y);
    context.stroke();
    context.setLineDash([]);
  }

  function curve({context, columns}, scale, base, colour) {
    const gap = gapColumns(GAP_S, columns, WINDOW_S);
    context.strokeStyle = colour;
    context.lineWidth = 1.5;
    context.beginPath();
    let last = -Infinity;
    for (let x = 0; x < columns; x += 1) {
      if (Number.isNaN(low[x])) continue;
      if (x - last > gap) context.moveTo(LEFT + x, scale(low[x] - base));
      else context.lineTo(LEFT + x, scale(low[x] - base));
      // a single column is drawn, too
      context.lineTo(LEFT + x + 0.5, scale(high[x] - base));
      last = x;
    }
    context.stroke();
  }

  function marks({context, columns, end, colour}, mine) {
    context.strokeStyle = colour("--bad");
    context.fillStyle = colour("--bad");
    context.lineWidth = 1;
    context.globalAlpha = 0.7;
    for (let number = 0; number < mine.marks.size; number += 1) {
      const {time} = mine.marks.at(number);
      if (time < end - WINDOW_S || time > end) continue;
      const x = Math.round(LEFT + (columns * (time - end + WINDOW_S)) / WINDOW_S) + 0.5;
      context.beginPath();
      context.moveTo(x, TOP);
      context.lineTo(x, HEIGHT - BOTTOM);
      context.stroke();
      context.beginPath();
      context.moveTo(x - 4, TOP - 6);
      context.lineTo(x + 4, TOP - 6);
      context.lineTo(x, TOP + 1);
      context.fill();
    }
    context.globalAlpha = 1;
  }

  // -- words

  function showLegend(mine) {
    shownHistory = mine;
    shownMark = -1;
    hidden.clear();
    clear(legend);
    mine.names.forEach((name, joint) => {
      const choose = button(legend, "", () => {
        if (!hidden.delete(joint)) hidden.add(joint);
        choose.setAttribute("aria-pressed", String(!hidden.has(joint)));
        draw();
      }, {className: `curve curve-${(joint % COLOURS) + 1}`, "aria-pressed": "true"});
      add(choose, "span", {className: "curve-colour", "aria-hidden": "true"});
      add(choose, "span", {text: name});
    });
  }

  function showFaults(mine, end) {
    const count = mine.marks.size;
    const newest = count === 0 ? 0 : mine.marks.at(count - 1).time;
    const oldest = count === 0 ? 0 : mine.marks.at(0).time;
    // ages are shown in minutes
    const state = newest * 1e6 + oldest + count + Math.floor(end / 15);
    if (state === shownMark) return;
    shownMark = state;
    clear(list);
    for (let number = count - 1; number >= Math.max(0, count - TOLD); number -= 1) {
      const mark = mine.marks.at(number);
      if (mark.time < end - WINDOW_S) break;
      const ago = texts("plots.ago", {minutes: ((end - mark.time) / MINUTE).toFixed(1)});
      add(list, "li", {text: `${ago} ${texts(`plots.fault.${mark.kind}`)} ${mark.text}`.trim()});
    }
    noFault.hidden = list.children.length > 0;
  }

  function onExport() {
    const mine = history(store.selected);
    if (mine === null) return;
    const day = new Date().toISOString().slice(0, 19).replaceAll(":", "-");
    save(`${store.selected}_${day}.csv`, csv(mine, now() - WINDOW_S));
  }

  function saveFile(name, text) {
    const address = URL.createObjectURL(new Blob([text], {type: "text/csv;charset=utf-8"}));
    const link = add(parent, "a", {href: address, download: name, hidden: true});
    link.click();
    link.remove();
    setTimeout(() => URL.revokeObjectURL(address), 10000);
  }

  store.on("view", onView);
  store.on("old", (robot, old) => history(robot)?.heard(now(), !old, ""));
  store.on("selected", draw);
  const look = () => {
    if (isSeen()) draw();
  };
  setInterval(look, DRAW_EVERY).unref?.();
  parent.tab?.onOpen(look);
  draw();
}

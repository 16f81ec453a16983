/**
 * The picture: all robots that were heard, side by side, drawn by WebGL. Each has its own camera and takes its own gestures.
 *
 * It draws only when something has changed, at most 30 times a second and at most half of the time: where a processor draws in place
 * of a graphics chip, a frame may hold the page up for a tenth of a second, and a message or a tapped stop waits for its end. For
 * tests the canvas has `inspect(robot)`, which tells what is drawn, and `frames`, `frameTime` (how many, and for how long the last
 * held the page up [ms]).
 */
import {WebGLRenderer} from "three";
import {add, button, setText} from "../dom.js";
import {makeCell} from "./cell.js";
import {makeReplayNotice} from "./replay_notice.js";
import {IN_VIEW, seenWord} from "./seen.js";

const VIEWS = ["home", "front", "side", "top", "tool"];
/** Shortest time between two frames [ms]. */
const FRAME = 32;
/** Most robots that are drawn at once. */
const MOST = 4;
/** Narrower pictures show one robot at a time [px]. */
const NARROW = 500;

/** Names of what draws without a graphics chip, as browsers tell them. */
const PROCESSOR = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** Whether a processor draws in place of a graphics chip. A canvas's own context cannot be made anew, so another one is asked. */
function processorDraws() {
  const context = document.createElement("canvas").getContext("webgl2");
  if (context === null) return false;
  const names = context.getExtension("WEBGL_debug_renderer_info");
  const name = context.getParameter(names === null ? context.RENDERER : names.UNMASKED_RENDERER_WEBGL);
  context.getExtension("WEBGL_lose_context")?.loseContext();
  return PROCESSOR.test(name);
}

/** Make the picture. */
export function make(parent, store, connection, texts) {
  const stage = add(parent, "div", {className: "stage"});
  const canvas = add(stage, "canvas", {className: "canvas", role: "img", "aria-label": texts("picture.label")});
  const note = add(stage, "p", {className: "picture-note", role: "status", hidden: true});
  const bar = add(parent, "div", {className: "views", role: "group", "aria-label": texts("picture.views")});
  const legend = add(parent, "ul", {className: "legend"});
  let renderer;
  try {
    // smooth edges more than double the time of a frame that a processor draws
    const antialias = !processorDraws();
    renderer = new WebGLRenderer({canvas, antialias, alpha: true, powerPreference: "low-power"});
  } catch (error) {
    // three throws a plain Error where there is no WebGL
    note.hidden = false;
    setText(note, texts("picture.no_webgl"));
    console.warn(error.message);
    return;
  }
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.setScissorTest(true);

  const cells = new Map();
  let alone = false;
  let dirty = true;
  let width = 0;
  let height = 0;
  let nextFrame = 0;
  let began = 0;
  let lost = false;
  let inView = 0;
  let observer = null;
  let covered = "";
  canvas.frames = 0;
  canvas.frameTime = 0;
  canvas.inspect = (name) => cells.get(name)?.cell.inspect() ?? null;
  const redraw = () => {
    dirty = true;
  };

  for (const view of VIEWS) {
    button(bar, texts(`picture.view.${view}`), () => {
      for (const {cell} of shown()) if (shown().length === 1 || cell.name === store.selected) cell.look(view);
    });
  }
  const all = button(bar, texts("picture.all"), () => {
    alone = !alone;
    arrange();
  });
  const turn = button(bar, texts("picture.turn"), () => {
    const cell = cells.get(store.selected)?.cell;
    if (cell) cell.turns = !cell.turns;
    showBar();
    redraw();
  });
  const entries = {};
  for (const what of ["twin", "arm", "path", "goal", "plan", "closest", "reach"]) {
    const entry = add(legend, "li", {className: `legend-${what}`});
    add(entry, "span", {className: "swatch", "aria-hidden": "true"});
    entries[what] = {entry, label: add(entry, "span")};
    if (what !== "closest") setText(entries[what].label, texts(`picture.legend.${what}`));
  }

  function shown() {
    const one = alone || width < NARROW;
    return [...cells.values()].filter(({cell}) => (one ? cell.name === store.selected : true)).slice(0, MOST);
  }

  function showBar() {
    all.hidden = store.robots.length < 2 || width < NARROW;
    all.setAttribute("aria-pressed", String(!alone));
    turn.hidden = !store.robot(store.selected)?.handle;
    turn.setAttribute("aria-pressed", String(cells.get(store.selected)?.cell.turns ?? false));
  }

  function colour(name) {
    return getComputedStyle(stage).getPropertyValue(name).trim();
  }

  function theme() {
    for (const {cell} of cells.values()) cell.theme(colour("--grid"));
    redraw();
  }

  function arrange() {
    const box = stage.getBoundingClientRect();
    if (box.width < 1 || box.height < 1) return;
    width = box.width;
    height = box.height;
    renderer.setSize(width, height, false);
    const visible = shown();
    for (const each of cells.values()) each.overlay.hidden = !visible.includes(each);
    visible.forEach(({cell, overlay}, k) => {
      const part = width / visible.length;
      overlay.style.setProperty("left", `${k * part}px`);
      overlay.style.setProperty("width", `${part}px`);
      cell.resize(part, height);
      overlay.classList.toggle("selected", visible.length > 1 && cell.name === store.selected);
    });
    showBar();
    watch();
    tellSeen();
    // another size has emptied the picture: nobody is to see it empty
    paint();
  }

  // -- what a person can see of it

  /** Tell the others whether each robot can be seen. It is seen once it was drawn, and is not from the moment when it cannot be. */
  function tellSeen(wasDrawn = false) {
    const visible = shown();
    for (const [name, each] of cells) {
      const word = seenWord({
        lost, ready: each.cell.ready, shown: visible.includes(each), inView, visible: document.visibilityState === "visible",
        replay: store.robot(name).replay !== null,
      });
      const before = store.robot(name).drawn;
      if (word === before) continue;
      if (word === "seen" && !wasDrawn) redraw();
      else store.set("drawn", name, word);
    }
  }

  /** Watch how much of the picture is in view; what the style has the page scroll to above its lower edge, the stop covers. */
  function watch() {
    const bottom = getComputedStyle(document.documentElement).scrollPaddingBottom;
    const now = bottom.endsWith("px") ? bottom : "0px";
    if (observer !== null && now === covered) return;
    observer?.disconnect();
    covered = now;
    observer = new IntersectionObserver((entries) => {
      inView = entries.at(-1).intersectionRatio;
      tellSeen();
    }, {threshold: [0, IN_VIEW], rootMargin: `0px 0px -${covered} 0px`});
    observer.observe(canvas);
  }

  function addRobots() {
    for (const name of store.robots) {
      if (cells.has(name) || cells.size >= MOST) continue;
      const overlay = add(stage, "div", {className: "overlay"});
      const label = add(overlay, "span", {className: "overlay-name", text: name});
      makeReplayNotice(overlay, name, store, texts);
      cells.set(name, {overlay, label, cell: makeCell(name, overlay, store, redraw)});
    }
    theme();
    arrange();
  }

  function showNote() {
    const robot = store.robot(store.selected);
    const state = cells.get(store.selected)?.cell.state;
    let text = "";
    if (lost) text = texts("picture.lost");
    else if (state?.progress) text = texts("picture.loading", state.progress);
    else if (state?.failed) text = texts("picture.no_model", {why: state.failed});
    else if (state?.missing.length) text = texts("picture.no_model", {why: state.missing.join(", ")});
    else if (robot?.playback) text = texts("picture.playback", {time: robot.playback.time.toFixed(1)});
    else if (state?.stale) text = texts("picture.stale");
    else if (state?.lacks) text = texts("picture.lacks", {why: state.lacks});
    note.hidden = text === "";
    setText(note, text);
  }

  function showLegend() {
    const robot = store.robot(store.selected);
    const replay = robot?.replay ?? null;
    const closest = robot?.view?.closest ?? null;
    const plan = robot?.plan?.refused === "" ? robot.plan : null;
    const there = replay !== null ? {twin: replay.twin, arm: replay.arm} : {
      twin: robot?.view?.twin, arm: robot?.view?.arm, path: plan, goal: plan ?? robot?.goal, plan: robot?.playback,
      closest: closest && Number.isFinite(closest.distance), reach: robot?.goal?.reach,
    };
    for (const [what, {entry}] of Object.entries(entries)) entry.hidden = !there[what];
    if (there.closest) {
      setText(entries.closest.label,
        texts("picture.legend.closest", {distance: (1000 * closest.distance).toFixed(0), between: (closest.between ?? []).join(" - ")}));
    }
    if (there.reach) {
      entries.reach.entry.dataset.reach = robot.goal.reach;
      setText(entries.reach.label, texts(`picture.reach.${["free", "contact", "out"].includes(robot.goal.reach) ? robot.goal.reach : "unknown"}`));
    }
    entries.arm.entry.dataset.sync = (replay === null ? robot?.view?.sync?.state : replay.sync) ?? "";
  }

  // the browser waits for the drawing after `draw` has returned: a frame ends where the page gets its next turn
  const turns = new MessageChannel();
  turns.port1.onmessage = () => {
    const ended = performance.now();
    canvas.frameTime = ended - began;
    nextFrame = Math.max(began + FRAME, ended + canvas.frameTime);
  };

  function draw() {
    requestAnimationFrame(draw);
    if (dirty && width > 0 && performance.now() >= nextFrame) paint();
  }

  function paint() {
    dirty = false;
    began = performance.now();
    nextFrame = Infinity;
    turns.port2.postMessage(null);
    showNote();
    showLegend();
    // three draws nothing then, and says nothing
    if (lost) return;
    const visible = shown();
    visible.forEach(({cell}, k) => {
      const part = width / visible.length;
      renderer.setViewport(k * part, 0, part, height);
      renderer.setScissor(k * part, 0, part, height);
      renderer.render(cell.scene, cell.camera);
    });
    canvas.frames += 1;
    tellSeen(true);
  }

  store.on("robots", addRobots);
  store.on("selected", arrange);
  store.on("handle", showBar);
  for (const kind of ["playback", "goal", "plan", "connection"]) store.on(kind, redraw);
  store.on("replay", () => {
    tellSeen();
    redraw();
  });
  canvas.addEventListener("webglcontextlost", () => {
    lost = true;
    tellSeen();
    redraw();
  });
  canvas.addEventListener("webglcontextrestored", () => {
    lost = false;
    redraw();
  });
  document.addEventListener("visibilitychange", () => tellSeen());
  new ResizeObserver(arrange).observe(stage);
  addEventListener("theme", theme);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", theme);
  addRobots();
  requestAnimationFrame(draw);
}

/**
 * The picture: all robots that were heard, side by side, drawn by WebGL. Each has its own camera and takes its own
 * gestures.
 *
 * It draws only when something has changed, at most 30 times a second and at most half of the time: where a processor
 * draws in place of a graphics chip, a frame may hold the page up for a tenth of a second, and a message or a tapped
 * stop waits for its end. For tests the canvas has `inspect(robot)`, which tells what is drawn, and `frames` and
 * `frameTime` (how many, and for how long the last held the page up [ms]).
 */
import {PCFShadowMap, WebGLRenderer} from "three";
import {add, button, clear, setText} from "../dom.js";
import {makeCell} from "./cell.js";
import {millimetres} from "./closest.js";
import {drawIcon} from "./icons.js";
import {mark} from "../texts.js";
import {makeLabels} from "./labels.js";
import {entriesOf} from "./legend.js";
import {IN_VIEW, seenWord} from "./seen.js";

const VIEWS = {
  home: mark("Fit: show the whole cell"), front: mark("Front"), side: mark("Side"), top: mark("Top"), tool: mark("Tool"),
};
/** Smaller parts of the picture begin with the legend folded [px]. */
const ROOMY = {width: 620, height: 340};
/** So much of the picture's width is left to an open legend: less than it takes, because little is drawn in that corner. */
const LEGEND = 0.14;
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

export function make(parent, store, connection, texts) {
  const stage = add(parent, "div", {className: "stage"});
  const canvas = add(stage, "canvas", {className: "canvas", role: "img",
    "aria-label": texts("The robot: drag to turn, two fingers or the right button to move, pinch or wheel to zoom")});
  // above the robots' parts, which come as they are heard
  const above = add(stage, "div", {className: "above"});
  const note = add(above, "p", {className: "picture-note", role: "status", hidden: true});
  const bar = add(above, "div", {className: "views", role: "group", "aria-label": texts("Views")});
  const legend = add(above, "details", {className: "legend"});
  add(legend, "summary", {text: texts("Legend")});
  const list = add(legend, "ul");
  const software = processorDraws();
  let renderer;
  try {
    // smooth edges more than double the time of a frame that a processor draws
    const antialias = !software;
    renderer = new WebGLRenderer({canvas, antialias, alpha: true, powerPreference: "low-power"});
  } catch (error) {
    // three throws a plain Error where there is no WebGL
    bar.hidden = legend.hidden = true;
    note.hidden = false;
    setText(note, texts("This browser has no WebGL: nothing can be drawn. The rest of the page works."));
    console.warn(error.message);
    return;
  }
  renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
  renderer.setScissorTest(true);
  renderer.shadowMap.enabled = true;
  renderer.shadowMap.type = PCFShadowMap;

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
  let folded = null;
  let listed = "";
  let covers = null;
  canvas.frames = 0;
  canvas.frameTime = 0;
  canvas.inspect = (name) => {
    const each = cells.get(name);
    return each === undefined ? null : {...each.cell.inspect(), words: each.words};
  };
  const redraw = () => {
    dirty = true;
  };

  /** Make a button with a drawing in place of words, which are said and shown beside the pointer. */
  function tool(what, words, onClick) {
    const made = button(bar, undefined, onClick, {className: `tool tool-${what}`, "aria-label": words, title: words});
    drawIcon(made, what);
    return made;
  }

  for (const [view, words] of Object.entries(VIEWS)) {
    tool(view, texts(words), () => {
      for (const {cell} of shown()) if (shown().length === 1 || cell.name === store.selected) cell.look(view);
    });
  }
  const all = tool("all", texts("All robots"), () => {
    alone = !alone;
    arrange();
  });
  legend.addEventListener("toggle", () => {
    // a person has folded or opened it: it stays
    if (legend.open !== folded) folded = undefined;
    arrange();
  });

  function shown() {
    const one = alone || width < NARROW;
    return [...cells.values()].filter(({cell}) => (one ? cell.name === store.selected : true)).slice(0, MOST);
  }

  function showBar() {
    all.hidden = store.robots.length < 2 || width < NARROW;
    all.setAttribute("aria-pressed", String(!alone));
  }

  function colour(name) {
    return getComputedStyle(stage).getPropertyValue(name).trim();
  }

  function theme() {
    for (const {cell} of cells.values()) cell.theme(colour("--floor"), colour("--grid"));
    redraw();
  }

  /** Return where the picture is covered by words and buttons, in its pixels; asked for only after these have changed. */
  function places() {
    if (covers !== null) return covers;
    const from = stage.getBoundingClientRect();
    covers = [note, bar, legend].filter(({hidden}) => !hidden).map((element) => {
      const box = element.getBoundingClientRect();
      return {x: box.left - from.left, y: box.top - from.top, width: box.width, height: box.height};
    });
    return covers;
  }

  function arrange() {
    const box = stage.getBoundingClientRect();
    if (box.width < 1 || box.height < 1) return;
    width = box.width;
    height = box.height;
    renderer.setSize(width, height, false);
    const visible = shown();
    if (folded !== undefined) {
      folded = width / visible.length >= ROOMY.width && height >= ROOMY.height;
      legend.open = folded;
    }
    showBar();
    covers = null;
    const buttons = bar.getBoundingClientRect();
    for (const each of cells.values()) each.overlay.hidden = !visible.includes(each);
    visible.forEach(({cell, overlay}, k) => {
      const part = width / visible.length;
      overlay.style.setProperty("left", `${k * part}px`);
      overlay.style.setProperty("width", `${part}px`);
      // what is drawn keeps clear of the buttons, of the name and of the legend's line
      const right = k === visible.length - 1 ? Math.min(0.2, (buttons.width + 12) / part) : 0.03;
      const left = k === 0 && legend.open ? LEGEND : 0.04;
      cell.resize(part, height, {left, right, top: Math.min(0.12, 40 / height), bottom: Math.min(0.06, 20 / height)});
      overlay.classList.toggle("selected", visible.length > 1 && cell.name === store.selected);
    });
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
        size: {width: width / Math.max(1, visible.length), height},
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
      const overlay = add(stage, "div", {className: "overlay", role: "group", "aria-label": texts("Picture of {robot}", {robot: name})});
      add(overlay, "span", {className: "overlay-name", text: name});
      const cell = makeCell(name, overlay, store, redraw, renderer.getPixelRatio());
      cell.shadows(!software);
      const each = {overlay, cell, show: makeLabels(overlay), words: []};
      stage.append(above);
      cells.set(name, each);
    }
    theme();
    arrange();
  }

  function showNote() {
    const robot = store.robot(store.selected);
    const state = cells.get(store.selected)?.cell.state;
    let text = "";
    const why = state?.failed || state?.missing.join(", ");
    if (lost) {
      text = texts("The browser has taken the graphics away from this page: nothing is drawn until it gives them back. "
        + "If that takes long, reload the page.");
    } else if (state?.progress) text = texts("Loading the robot model: {done} of {all} files", state.progress);
    else if (why) text = texts("The robot model could not be loaded ({why}). The rest of the page works.", {why});
    else if (robot?.playback) text = texts("The picture shows the plan at {time} s, not the present.", {time: robot.playback.time.toFixed(1)});
    else if (state?.stale) {
      text = texts("The building model here is not the one that the tasks are of: it is not shown, and is fetched again.");
    } else if (state?.lacks || state?.unread) text = texts("A part of the picture is missing ({why}).", {why: state.lacks || state.unread});
    if (note.textContent === text && note.hidden === (text === "")) return;
    note.hidden = text === "";
    setText(note, text);
    covers = null;
  }

  /** Show an entry for each kind of thing that is drawn of the selected robot, in its colour. */
  function showLegend() {
    const drawn = cells.get(store.selected)?.cell.drawn() ?? null;
    const entries = drawn === null ? [] : entriesOf(drawn);
    const values = drawn?.closest ? {
      distance: millimetres(drawn.closest.distance), between: drawn.closest.between.join(" - "), time: drawn.closest.time.toFixed(1),
    } : {};
    const lines = entries.map(({id, words, colour: value, form}) => ({
      id, form, text: texts(words, values), colour: `#${value.toString(16).padStart(6, "0")}`,
    }));
    const wanted = JSON.stringify(lines);
    if (wanted === listed) return;
    listed = wanted;
    covers = null;
    legend.hidden = lines.length === 0;
    clear(list);
    for (const {id, form, text, colour: value} of lines) {
      const entry = add(list, "li", {className: `legend-${id}`});
      add(entry, "span", {className: `swatch swatch-${form}`, "aria-hidden": "true"}).style.setProperty("--drawn", value);
      add(entry, "span", {text});
    }
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
    visible.forEach((each, k) => {
      const part = width / visible.length;
      const boxes = places().map((box) => ({...box, x: box.x - k * part}));
      each.words = each.show(each.cell.labels(part, height), part, height, [...boxes, {x: 0, y: 0, width: 120, height: 36}]);
    });
    canvas.frames += 1;
    tellSeen(true);
  }

  store.on("robots", addRobots);
  store.on("selected", () => {
    arrange();
    redraw();
  });
  for (const kind of ["playback", "goal", "plan", "connection"]) store.on(kind, redraw);
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
  addRobots();
  requestAnimationFrame(draw);
}

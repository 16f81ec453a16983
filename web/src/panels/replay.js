/**
 * Replay of a recorded run in the picture: twin and arm as they were, a slider with the error as a curve and with marks, and the run's
 * report beside it. The picture says that it is a recording (picture/replay_notice.js), nothing can be approved meanwhile
 * (verdict_state.js), and the replay ends at once when the present asks for a person: replay/present.js. Stop is where it always is.
 */
import {add, button, clear, setText} from "../dom.js";
import {advanced, rewound, sought, toggled} from "../motion.js";
import {curveOf, errorAt, loadReplay, markAt, pathOf, poseAt, ReplayError} from "../replay/file.js";
import {isNeeded, presentOf} from "../replay/present.js";
import {browser} from "./clock.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4, 10];
const SVG = "http://www.w3.org/2000/svg";
/** The curve's size in units of its own: it is stretched to the slider's. One unit is one point of the curve, `COLUMNS` at most. */
const COLUMNS = 600;
const HEIGHT = 48;
/** Marks are jumped to from this far away [s]. */
const BESIDE = 0.005;

const three = (value) => (value === 0 ? "0" : Math.abs(value) < 0.001 ? value.toExponential(2) : value.toPrecision(3));

/** Make the panel. `load` is for tests. */
export function make(parent, store, connection, texts, {now, frame, load = loadReplay} = browser) {
  const told = add(parent, "p", {className: "replay-told", role: "alert", hidden: true});
  const area = add(parent, "div", {className: "replay", role: "group", "aria-label": texts("replay.title"), hidden: true});
  const left = add(area, "div", {className: "replay-time"});
  const head = add(left, "p", {className: "replay-head"});
  const controls = add(left, "div", {className: "replay-controls"});
  const play = button(controls, "", () => onPlay(), {className: "replay-play"});
  const speed = add(controls, "select", {className: "replay-speed", "aria-label": texts("playback.speed")});
  for (const each of SPEEDS) {
    const option = add(speed, "option", {value: String(each), text: texts("playback.times", {speed: each})});
    option.selected = each === 1;
  }
  button(controls, texts("replay.before"), () => jump(-1), {className: "quiet"});
  button(controls, texts("replay.after"), () => jump(1), {className: "quiet"});
  button(controls, texts("replay.end"), () => end(""), {className: "replay-end"});
  const row = add(left, "div", {className: "replay-row"});
  const drawing = row.ownerDocument.createElementNS(SVG, "svg");
  for (const [name, value] of [["class", "replay-curve"], ["preserveAspectRatio", "none"], ["aria-hidden", "true"]]) {
    drawing.setAttribute(name, value);
  }
  row.append(drawing);
  const slider = add(row, "input", {type: "range", className: "replay-slider", min: "0", max: "1", step: "0.02", value: "0",
    "aria-label": texts("replay.slider")});
  const clock = add(left, "p", {className: "replay-clock"});
  const mark = add(left, "p", {className: "replay-mark"});
  const report = add(area, "div", {className: "replay-report"});
  let shown = null;
  let motion = null;
  let drawnAt = 0;
  let turn = 0;
  let began = "";
  let goal = "";

  const tell = (sentence) => {
    told.hidden = sentence === "";
    setText(told, sentence);
  };
  const goalOf = (robot) => JSON.stringify(store.robot(robot)?.goal?.positions ?? null);

  // -- the picture

  function draw() {
    const {recording, run} = shown;
    const {time} = motion;
    const present = presentOf(store.robot(recording.robot));
    store.set("replay", recording.robot, {
      run, time, at: new Date(recording.begin.getTime() + 1000 * time), names: recording.joints, twin: poseAt(recording, "twin", time),
      arm: poseAt(recording, "arm", time), sync: markAt(recording, time, "gate")?.state ?? "", present: present.word,
    });
    setText(play, texts(motion.playing ? "playback.pause" : "playback.play"));
    slider.value = String(time);
    const values = {time: time.toFixed(2), duration: recording.duration.toFixed(1)};
    const error = errorAt(recording, time);
    setText(clock, `${texts("playback.time", values)} ${error === null ? texts("replay.no_error")
      : texts("replay.error", {joint: error.joint, value: three(error.value), unit: error.unit})}`);
    const last = markAt(recording, time);
    setText(mark, last === null ? "" : wordsOf(last));
    mark.classList.toggle("is-fault", last?.fault ?? false);
    slider.setAttribute("aria-valuetext", [texts("playback.time", values), last === null ? "" : wordsOf(last)].filter(Boolean).join(", "));
    for (const name of ["x1", "x2"]) drawing.lastChild.setAttribute(name, String(placeOf(time)));
  }

  function wordsOf({time, source, state, reason, by}) {
    const who = texts.has(`replay.source.${source}`) ? texts(`replay.source.${source}`) : source;
    const verdict = source === "review" && ["approved", "rejected"].includes(state);
    const what = verdict ? texts(`replay.verdict.${state}`, {by}) : state;
    return texts(reason ? "replay.mark_why" : "replay.mark", {time: time.toFixed(2), who, what, reason: texts.reason(reason)});
  }

  function onFrame() {
    if (motion === null || !motion.playing) return;
    const at = now();
    motion = advanced(motion, (at - drawnAt) / 1000);
    drawnAt = at;
    draw();
    if (motion?.playing) frame(onFrame);
  }

  function onPlay() {
    motion = toggled(motion);
    drawnAt = now();
    draw();
    if (motion.playing) frame(onFrame);
  }

  function seek(time) {
    motion = sought({...motion, playing: false}, time);
    draw();
  }

  function jump(way) {
    const times = shown.recording.marks.map(({time}) => time).filter((time) => way * (time - motion.time) > BESIDE);
    if (times.length) seek(way > 0 ? Math.min(...times) : Math.max(...times));
  }

  speed.addEventListener("change", () => {
    if (motion !== null) motion = {...motion, speed: Number(speed.value)};
  });
  slider.addEventListener("input", () => {
    if (motion !== null) seek(Number(slider.value));
  });

  // -- begin and end

  const layout = (on) => {
    area.hidden = !on;
    parent.closest(".areas")?.classList.toggle("is-replaying", on);
  };

  async function begin(robot, {run, href, report: address}) {
    turn += 1;
    const mine = turn;
    end("");
    tell(texts("replay.loading", {run}));
    parent.scrollIntoView?.({block: "nearest"});
    let recording;
    try {
      recording = await load(href);
    } catch (error) {
      if (mine !== turn) return;
      if (!(error instanceof ReplayError)) throw error;
      tell(texts("replay.refused", {run, why: texts(error.key, error.values)}));
      return;
    }
    // another was asked for, or the connection has ended, meanwhile
    if (mine !== turn) return;
    const known = store.robot(recording.robot);
    if (known === null) {
      tell(texts("replay.refused", {run, why: texts("replay.other_robot", {robot: recording.robot})}));
      return;
    }
    const present = presentOf(known);
    if (isNeeded(present)) {
      tell(texts(`replay.ended.${present.word}`));
      return;
    }
    tell("");
    store.select(recording.robot);
    began = present.key;
    goal = goalOf(recording.robot);
    shown = {recording, run};
    motion = {...rewound(recording.duration), speed: Number(speed.value) || 1};
    setText(head, texts("replay.head", {run, robot: recording.robot, time: recording.begin.toLocaleString(texts.language)}));
    slider.setAttribute("max", String(recording.duration));
    showCurve(recording);
    showReport(recording, address);
    layout(true);
    draw();
  }

  /** Show the present again; `word` says why, "" where the person wanted it. */
  function end(word) {
    if (shown === null) return;
    const {robot} = shown.recording;
    shown = null;
    motion = null;
    layout(false);
    store.set("replay", robot, null);
    tell(word === "" ? "" : texts(`replay.ended.${word}`));
  }

  function look(robot) {
    if (shown === null || robot !== shown.recording.robot) return;
    const present = presentOf(store.robot(robot));
    if (present.key === began) return;
    if (present.word === "") {
      // what was wrong when it began is over: the next time it counts
      began = "";
      draw();
    } else {
      end(present.word);
    }
  }

  // -- curve and report

  const columns = () => Math.min(COLUMNS, shown.recording.rows);
  /** Where a time is on the curve, of which a point stands for each row or for several. */
  const placeOf = (time) => (columns() - 1) * time / shown.recording.duration;

  function showCurve(recording) {
    clear(drawing);
    drawing.setAttribute("viewBox", `0 0 ${columns() - 1} ${HEIGHT}`);
    const line = (tag, className, values) => {
      const element = drawing.ownerDocument.createElementNS(SVG, tag);
      element.setAttribute("class", className);
      for (const [name, value] of Object.entries(values)) element.setAttribute(name, String(value));
      drawing.append(element);
    };
    for (const {time, fault, source} of recording.marks) {
      const x = placeOf(time);
      line("line", `replay-tick ${fault ? "is-fault" : source === "review" ? "is-verdict" : ""}`, {x1: x, x2: x, y1: fault ? 0 : HEIGHT / 2, y2: HEIGHT});
    }
    line("path", "replay-error", {d: pathOf(curveOf(recording, columns()), HEIGHT)});
    line("line", "replay-now", {x1: 0, x2: 0, y1: 0, y2: HEIGHT});
  }

  function showReport({report: figures, types, joints, alignment, leftOut}, address) {
    clear(report);
    add(report, "h3", {text: texts("replay.report")});
    const table = add(report, "table");
    const headings = add(add(table, "thead"), "tr");
    for (const key of ["joint", "average", "largest", "paper"]) add(headings, "th", {scope: "col", text: texts(`replay.column.${key}`)});
    const body = add(table, "tbody");
    for (const each of figures.table) {
      const line = add(body, "tr");
      const unit = types[joints.indexOf(each.joint)] === "prismatic" ? " m" : "";
      add(line, "th", {scope: "row", text: each.joint});
      for (const value of [each.average, each.largest]) add(line, "td", {text: `${value.toExponential(2)}${unit}`});
      add(line, "td", {text: each.paper_largest === null ? "" : each.paper_largest.toExponential(2)});
    }
    const known = (value, digits) => (value === null ? texts("replay.unknown") : value.toFixed(digits));
    const facts = texts("replay.facts", {
      seconds: known(figures.duration, 1), samples: known(figures.samples, 0), lost: known(figures.commands_lost, 0),
      late: known(figures.late_replies, 0), trip: known(figures.round_trip_ms, 1),
    });
    const how = texts.has(`replay.alignment.${alignment}`) ? texts(`replay.alignment.${alignment}`) : alignment;
    for (const sentence of [how, facts, figures.mock ? texts("replay.mock") : "", leftOut ? texts("replay.left_out", {count: leftOut}) : ""]) {
      if (sentence) add(report, "p", {text: sentence});
    }
    add(report, "a", {href: address, target: "_blank", rel: "noopener", text: texts("replay.whole")});
  }

  store.on("replay_run", begin);
  for (const kind of ["view", "plan"]) store.on(kind, look);
  store.on("goal", (robot) => {
    if (shown !== null && robot === shown.recording.robot && goalOf(robot) !== goal) end("goal");
  });
  store.on("selected", (robot) => {
    if (shown !== null && robot !== shown.recording.robot) end("robot");
  });
  store.on("connection", (_, state) => {
    if (state === "connected") return;
    turn += 1;
    end("connection");
  });
}

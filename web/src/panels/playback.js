/**
 * Playback of the plan under review: the picture shows it at a time that a person chooses. Only a plan whose hash was
 * checked is played, from the very numbers that the hash covers. What was shown is told to the verdict panel: `looked`
 * {what, hash}. While the picture is not in view the playback waits, so that nothing of the motion is missed; where
 * there is no picture it goes on, and does not count as played.
 */
import {add, clear, setText} from "../dom.js";
import {advanced, durationOf, rewound, sample, sought, toggled, wasPlayed} from "../motion.js";
import {browser} from "./clock.js";

const SPEEDS = [0.25, 0.5, 1, 2, 4];
const REPORT_EVERY = 200;

/** Return the segments of a plan with begin and end [s]; one without a name for a plan that has none. */
export function segmentsOf(plan) {
  const segments = plan.covered?.segments ?? plan.segments ?? [];
  if (segments.length === 0) return [{name: "", begin: 0, end: plan.duration, switches: []}];
  return segments.map((segment, k) => ({
    name: segment.name, begin: k ? segments[k - 1].end : 0, end: segment.end, switches: segment.switches ?? [],
  }));
}

/** Say what becomes of an output. */
export const switched = (output, value, texts) => (value ? texts("{output} on", {output}) : texts("{output} off", {output}));

export function make(parent, store, connection, texts, {now, every, frame} = browser) {
  const area = add(parent, "div", {className: "playback", role: "group", "aria-label": texts("Playback of the plan"), hidden: true});
  const controls = add(area, "div", {className: "playback-controls"});
  const play = add(controls, "button", {type: "button", className: "playback-play", on: {click: () => onPlay()}});
  const speed = add(controls, "select", {className: "playback-speed", "aria-label": texts("Playback speed")});
  for (const each of SPEEDS) {
    const option = add(speed, "option", {value: String(each), text: `${each} x`});
    option.selected = each === 1;
  }
  const present = add(controls, "button", {type: "button", className: "playback-present quiet", text: texts("Present"), hidden: true,
    on: {click: () => onPresent()}});
  const row = add(area, "div", {className: "playback-row"});
  const slider = add(row, "input", {type: "range", className: "playback-slider", min: "0", max: "1", step: "0.01", value: "0",
    "aria-label": texts("Time in the plan")});
  const time = add(row, "span", {className: "playback-time"});
  const bar = add(area, "ol", {className: "playback-segments", "aria-label": texts("Segments")});
  const segment = add(area, "p", {className: "playback-segment"});
  const waiting = add(area, "p", {className: "playback-waits", role: "status", hidden: true,
    text: texts("Waits until the plan can be seen in the picture.")});
  let plan = null;
  let motion = null;
  let visible = false;
  let drawnAt = null;
  let shownOf = "";

  const canSee = () => store.robot(shownOf)?.drawn === "seen";
  /** Whether it waits for the picture: there is one, and it cannot be seen now. */
  const waits = () => !canSee() && (store.robot(shownOf)?.drawn ?? null) !== null;
  const told = (what) => store.set("looked", shownOf, {what, hash: plan.hash});

  const show = () => {
    area.hidden = motion === null;
    if (motion === null) return;
    setText(play, motion.playing ? texts("Pause") : texts("Play"));
    const values = {time: motion.time.toFixed(1), duration: motion.duration.toFixed(1)};
    setText(time, texts("{time} s of {duration} s", values));
    slider.value = String(motion.time);
    const parts = segmentsOf(plan);
    const number = Math.max(parts.findIndex(({end}) => motion.time < end), motion.time >= motion.duration ? parts.length - 1 : 0);
    const {name} = parts[number];
    setText(segment, name ? texts("Segment {number} of {count}: {name}", {number: number + 1, count: parts.length, name}) : "");
    slider.setAttribute("aria-valuetext", [texts("{time} s of {duration} s", values), name].filter(Boolean).join(", "));
    [...bar.children].forEach((item, k) => item.classList.toggle("is-now", k === number));
    present.hidden = !visible;
    waiting.hidden = !motion.playing || !waits();
  };

  const draw = () => {
    visible = true;
    store.set("playback", shownOf, {names: plan.joints, positions: sample(plan.trajectory, motion.time), time: motion.time});
    // a motion that nobody could see was not looked at: without a picture its checks must be opened
    if (wasPlayed(motion) && canSee()) told("played");
    show();
  };

  const hide = () => {
    if (!visible) return;
    visible = false;
    store.set("playback", shownOf, null);
  };

  function onFrame() {
    if (motion === null || !motion.playing) return;
    const at = now();
    if (waits()) {
      show();
    } else {
      motion = advanced(motion, (at - drawnAt) / 1000, canSee());
      draw();
    }
    drawnAt = at;
    if (motion.playing) frame(onFrame);
  }

  function onPlay() {
    motion = toggled(motion);
    drawnAt = now();
    draw();
    if (motion.playing) frame(onFrame);
  }

  function onPresent() {
    motion = {...motion, playing: false};
    hide();
    show();
  }

  speed.addEventListener("change", () => {
    motion = {...motion, speed: Number(speed.value)};
  });
  slider.addEventListener("input", () => {
    motion = sought({...motion, playing: false}, Number(slider.value));
    draw();
  });

  const onPlan = () => {
    const found = store.robot(store.selected)?.plan ?? null;
    const usable = found !== null && found.refused === "" && found.trajectory ? found : null;
    // the same plan is told again when a program starts: what was looked at stays
    if (usable !== null && plan !== null && usable.hash === plan.hash && usable.id === plan.id && shownOf === store.selected) return;
    hide();
    plan = usable;
    shownOf = store.selected;
    motion = plan === null ? null : {...rewound(durationOf(plan.trajectory)), speed: Number(speed.value) || 1};
    clear(bar);
    if (plan !== null) {
      slider.setAttribute("max", String(motion.duration));
      const parts = segmentsOf(plan);
      bar.hidden = parts.length < 2;
      for (const part of parts) {
        const item = add(bar, "li", {text: part.name, className: part.switches.length ? "has-switch" : ""});
        item.style.setProperty("flex-grow", String(Math.max(part.end - part.begin, 0.01)));
        if (part.switches.length) {
          const what = part.switches.map(({output, value}) => switched(output, value, texts)).join(", ");
          add(item, "span", {className: "playback-switch", text: what});
        }
      }
    }
    show();
  };
  store.on("plan", (robot) => {
    if (robot === store.selected) onPlan();
  });
  store.on("selected", onPlan);
  every(REPORT_EVERY, () => {
    if (plan !== null && parent.ownerDocument.visibilityState !== "hidden") told("shown");
  });
  onPlan();
}

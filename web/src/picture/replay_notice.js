/** Says over a robot's part of the picture, large, that it shows a recording and not the present. */
import {add, setText} from "../dom.js";

/**
 * Make the notice; it shows and hides itself.
 *
 * @param {Element} overlay the robot's part of the picture
 * @param {string} name of the robot
 * @param {object} store see store.js
 * @param {Function} texts see texts.js
 */
export function makeReplayNotice(overlay, name, store, texts) {
  const notice = add(overlay, "div", {className: "replay-notice", role: "status", hidden: true});
  add(notice, "strong", {text: texts("replay.notice")});
  const of = add(notice, "span");
  const now = add(notice, "span", {className: "replay-notice-now"});
  const show = () => {
    const replay = store.robot(name)?.replay ?? null;
    notice.hidden = replay === null;
    overlay.classList.toggle("is-replay", replay !== null);
    if (replay === null) return;
    setText(of, texts("replay.notice_of", {run: replay.run, time: replay.at.toLocaleString(texts.language)}));
    setText(now, replay.present === "" ? "" : texts(`replay.present.${replay.present}`));
  };
  store.on("replay", (robot) => {
    if (robot === name) show();
  });
  show();
}

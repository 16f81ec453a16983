/** Which panels stand in which area, in their order. */
import * as actions from "./panels/actions.js";
import * as messages from "./panels/messages.js";
import * as picture from "./picture/picture.js";
import * as motion from "./panels/motion.js";
import * as plan from "./panels/plan.js";
import * as playback from "./panels/playback.js";
import * as progress from "./panels/progress.js";
import * as speed from "./panels/speed.js";
import * as status from "./panels/status.js";
import * as stop from "./panels/stop.js";
import * as tasks from "./panels/tasks.js";
import * as verdict from "./panels/verdict.js";
import * as waypoints from "./panels/waypoints.js";

/** By area of page.js: modules with `make(parent, store, connection, texts)`. */
export const panels = {
  picture: [picture],
  status: [status, actions],
  stop: [stop],
  verdict: [progress, playback, verdict, speed, waypoints],
  motion: [motion],
  plan: [plan],
  tasks: [tasks],
  messages: [messages],
};

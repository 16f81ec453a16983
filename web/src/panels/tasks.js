/**
 * The tasks of a building model: what is done, what comes next, what is waited for; a plan of a task can be asked for.
 *
 * A tap on an element in the picture selects its task, and a task that is selected here is told to the picture
 * (`picked`). What only a person beside the element knows (is it in the grip?) is asked here, and answered by who has
 * the right, held to confirm.
 */
import {add, button, clear, setText} from "../dom.js";
import {showAsking} from "../planning/asking.js";
import {isBusy, makeRequests, showOutcome} from "../requests.js";
import {counts, isAskable, group, GROUPS, nextTask, taskOfElement, waitsFor} from "../work/task_list.js";
import {holdButton} from "../hold.js";
import {whoCan} from "../rights.js";
import {mark} from "../texts.js";
import {browser} from "./clock.js";

/** What a person can answer to the work's questions. */
const ANSWERS = {
  in_stock: mark("it lies in its stock, and the grip is empty"),
  in_grip: mark("it is in the grip, as it was taken"),
  placed: mark("it stands at its place, and the grip is empty"),
  gone: mark("it is none of these: it was taken away; it waits until it is skipped or done again"),
  same: mark("it is the one that stands there: it counts as placed"),
  stands: mark("it stands there: an obstacle until a person says that it was taken away"),
  taken_away: mark("it was taken away: it is no obstacle any more"),
  done: mark("it was done"),
  not_done: mark("it was not done: it is to be done again from its beginning"),
};

/** Make the panel; it and its area are hidden for a robot without a building model. */
export function make(parent, store, connection, texts, clock = browser) {
  const picks = new Map();
  let drawn = null;

  let asked = "";

  const root = add(parent, "div", {className: "tasks", hidden: true});
  const progress = add(root, "p", {className: "tasks-progress"});
  const bar = add(root, "progress", {max: 1, value: 0, "aria-label": texts("Tasks of the building model")});
  const reason = add(root, "p", {className: "tasks-reason", role: "status"});
  const next = add(root, "div", {className: "tasks-next"});
  const nextText = add(next, "p");
  const askNext = button(next, texts("Ask for the next task's plan"), () => onAsk({kind: "work_task"}), {className: "plan-ask"});
  const back = button(next, texts("Ask for the way back"), () => onAsk({kind: "way_back"}), {className: "plan-ask"});
  const answer = add(root, "p", {className: "plan-answer", role: "status"});
  const question = add(root, "div", {className: "tasks-asks", hidden: true});
  const ask = add(question, "p", {className: "tasks-question"});
  const choices = add(question, "div", {className: "tasks-answers"});
  const answered = add(question, "p", {className: "tasks-answered", role: "alert"});
  const list = add(root, "ul", {className: "tasks-list"});
  // below its task in the list: a list of many is longer than the screen
  const detail = add(root, "div", {className: "tasks-detail", role: "status", hidden: true});
  const notes = add(root, "ul", {className: "tasks-notes"});

  const requests = makeRequests(store, connection, clock, ["plan_request_ack"], () => show());
  const answers = makeRequests(store, connection, clock, ["answer_ack"], () => show());

  function work() {
    return store.robot(store.selected)?.tasks ?? null;
  }

  function onAsk(request) {
    if (!isBusy(requests.of(store.selected))) requests.send(store.selected, "plan_request", request);
  }

  function pick(task) {
    picks.set(store.selected, task?.id ?? null);
    store.set("picked", store.selected, task === null ? null : {element: task.element});
    show();
  }

  function onTap(robot, {element}) {
    const tasks = store.robot(robot)?.tasks;
    if (!tasks || robot !== store.selected || !element) return;
    const task = taskOfElement(tasks, element);
    if (task === null) return;
    pick(task);
    parent.tab?.open();
    const choose = list.querySelector('[aria-pressed="true"]');
    // all that is said of it; its name in any case
    for (const each of [choose?.parentElement, choose]) each?.scrollIntoView?.({block: "nearest"});
  }

  function show() {
    const now_ = work();
    root.hidden = now_ === null;
    parent.tab?.offer(now_ !== null);
    if (now_ === null) {
      drawn = null;
      return;
    }
    const {done, all} = counts(now_);
    setText(progress, texts("{done} of {all} done ({model})", {done, all, model: now_.model}));
    bar.setAttribute("value", String(all === 0 ? 0 : done / all));
    setText(reason, texts.reason(now_.reason));
    reason.hidden = now_.reason === "";
    showNext(now_);
    showAsking(answer, requests.of(store.selected), store.robot(store.selected).plan?.id ?? "", connection.account, texts);
    showList(now_);
    showDetail(now_);
  }

  function showNext(tasks) {
    const coming = nextTask(tasks);
    if (tasks.engaged) setText(nextText, texts("The arm was stopped in the middle of a task. Only the way back can be planned now."));
    else if (tasks.schedule === "proposed") setText(nextText, texts("The order of the tasks is a proposal. "
      + "Somebody must accept it at the robot's computer before anything can be planned."));
    else setText(nextText, coming === null ? texts("No task can be done now.") : texts("Next: {task}", {task: coming.name}));
    askNext.hidden = tasks.engaged || coming === null || tasks.schedule === "proposed";
    back.hidden = !tasks.engaged;
    askNext.disabled = !canAsk();
    back.disabled = !canAsk();
  }

  function canAsk() {
    return connection.state === "connected" && !isBusy(requests.of(store.selected));
  }

  function showList(tasks) {
    const picked = picks.get(store.selected) ?? null;
    if (drawn !== tasks) {
      drawn = tasks;
      root.insertBefore(detail, notes);
      clear(list);
      for (const task of tasks.tasks) {
        const item = add(list, "li");
        const kind = group(task.state);
        const toggle = () => pick(picks.get(store.selected) === task.id ? null : task);
        const choose = button(item, "", toggle, {className: `task task-${kind}`});
        add(choose, "span", {className: "task-name", text: task.name});
        add(choose, "span", {className: "task-state", text: stateText(task)});
      }
      clear(notes);
      for (const text of tasks.notes ?? []) add(notes, "li", {text: texts.reason(text)});
    }
    tasks.tasks.forEach((task, number) => {
      list.children[number].firstElementChild.setAttribute("aria-pressed", String(task.id === picked));
    });
  }

  function stateText(task) {
    return group(task.state) === "unknown" ? task.state : texts(GROUPS[group(task.state)]);
  }

  function showDetail(tasks) {
    const task = tasks.tasks.find((one) => one.id === picks.get(store.selected)) ?? null;
    // what is asked is shown before somebody chooses its task
    showQuestion(task ?? tasks.tasks.find((one) => one.question) ?? null);
    detail.hidden = task === null;
    clear(detail);
    if (task === null) return;
    const item = list.children[tasks.tasks.indexOf(task)];
    if (detail.parentElement !== item) item.append(detail);
    const element = task.element_name || task.element;
    const lines = [texts("Element: {element}", {element}), texts("State: {state}", {state: stateText(task)})];
    if (task.reason) lines.push(texts.reason(task.reason));
    const before = waitsFor(tasks, task);
    if (before.length > 0) lines.push(texts("First these must be done: {tasks}", {tasks: before.join(", ")}));
    if (task.robot) lines.push(texts("Done by {robot}", {robot: task.robot}));
    if (typeof task.deviation_mm === "number") {
      lines.push(texts("Placed {mm} mm and {deg}° off the model", {mm: task.deviation_mm.toFixed(1), deg: (task.deviation_deg ?? 0).toFixed(2)}));
    }
    for (const text of lines) add(detail, "p", {text});
    if (isAskable(tasks, task)) {
      button(detail, texts("Ask for this task's plan"), () => onAsk({kind: "work_task", task: task.id}), {className: "plan-ask", disabled: !canAsk()});
    }
  }

  /** Show what is asked, and its answers; the buttons stay what they are while the question does: a press must not lose them. */
  function showQuestion(task) {
    const robot = store.selected;
    const text = task?.question ?? "";
    const may = store.rightsOf.may(robot, "operate") !== false;
    question.hidden = text === "";
    const key = JSON.stringify([robot, task?.id, text, task?.answers, may]);
    if (asked !== key) {
      asked = key;
      clear(choices);
      setText(ask, text === "" ? "" : texts("Open question: {question}", {question: texts.reason(text)}));
      if (text !== "" && !may) {
        add(choices, "p", {text: `${texts("This account may not answer.")} ${whoCan(store.rightsOf.who(robot, "operate"), texts)}`});
      }
      for (const answer of may && text !== "" ? task.answers ?? [] : []) {
        holdButton(choices, {
          text: texts.word(ANSWERS, answer), className: "tasks-answer", onHeld: () => onAnswer(robot, task, answer),
          key: () => work()?.tasks.find(({id}) => id === task.id)?.question ?? "",
        }, clock);
      }
    }
    for (const each of choices.querySelectorAll("button")) each.disabled = connection.state !== "connected";
    const record = answers.of(robot);
    showOutcome(answered, record, texts, {what: texts("The answer"), hidden: record.payload.task !== task?.id});
  }

  function onAnswer(robot, task, answer) {
    answers.send(robot, "answer", {task: task.id, question: task.question, answer});
  }

  store.on("rights", show);
  store.on("tasks", (robot) => robot === store.selected && show());
  store.on("selected", show);
  store.on("tap", onTap);
  store.on("plan", show);
  store.on("connection", show);
  show();
}

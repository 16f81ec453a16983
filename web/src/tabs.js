/**
 * The panels that share one place beside the picture: a tab for each. Where the screen is wide enough some have a place
 * of their own and no tab: style.css says which, in `--own`, and is told by the class `offers-<name>` which panels have
 * anything in them.
 *
 * A panel's element has `tab`: `isOpen()`, `open()`, `offer(is)` (whether there is anything in it), `mark(text)` (a
 * number on its tab), and `onOpen(listener)`.
 */
import {add, button, setText} from "./dom.js";

/**
 * Make the tabs.
 *
 * @param {object} words templates of the panels by name, in their order; the first is open at first
 * @returns {Object<string, Element>} the panels by name
 */
export function makeTabs(parent, texts, words, makePanel) {
  const names = Object.keys(words);
  const list = add(parent, "div", {className: "tabs", role: "tablist", "aria-label": texts("Beside the picture")});
  const [first] = names;
  const panels = {};
  const tabs = {};
  // the one that was opened last comes first
  let opened = [...names];
  let own = [];
  let chosen = first;

  const usable = () => names.filter((name) => !tabs[name].hidden && !own.includes(name));
  const show = () => {
    own = globalThis.getComputedStyle?.(parent).getPropertyValue("--own").split(" ") ?? [];
    const there = usable();
    chosen = opened.find((name) => there.includes(name)) ?? first;
    for (const name of names) {
      tabs[name].setAttribute("aria-selected", String(name === chosen));
      tabs[name].setAttribute("tabindex", name === chosen ? "0" : "-1");
      panels[name].classList.toggle("is-chosen", name === chosen);
    }
  };
  const open = (name) => {
    if (tabs[name].hidden) return;
    opened = [name, ...opened.filter((each) => each !== name)];
    show();
    for (const listener of panels[name].tab.listeners) listener();
  };

  for (const name of names) {
    tabs[name] = button(list, "", () => open(name), {role: "tab", id: `tab-${name}`, className: `tab tab-${name}`, "aria-controls": name});
    add(tabs[name], "span", {text: texts(words[name])});
    const badge = add(tabs[name], "span", {className: "tab-badge", hidden: true});
    panels[name] = makePanel(name);
    panels[name].setAttribute("role", "tabpanel");
    panels[name].setAttribute("aria-labelledby", `tab-${name}`);
    panels[name].classList.add("panel");
    panels[name].tab = {
      listeners: [],
      isOpen: () => panels[name].getClientRects?.().length !== 0,
      open: () => open(name),
      onOpen: (listener) => panels[name].tab.listeners.push(listener),
      mark(text) {
        badge.hidden = text === "";
        setText(badge, text);
      },
      offer(is) {
        if (tabs[name].hidden === !is) return;
        tabs[name].hidden = !is;
        parent.classList.toggle(`offers-${name}`, is);
        // what is gone does not open by itself when it is there again
        if (!is) opened = [...opened.filter((each) => each !== name), name];
        if (!is && chosen === name) open(first);
        else show();
      },
    };
  }
  list.addEventListener("keydown", (event) => {
    const step = {ArrowRight: 1, ArrowLeft: -1}[event.key];
    if (step === undefined) return;
    const there = usable();
    const next = there[(there.indexOf(chosen) + step + there.length) % there.length];
    open(next);
    tabs[next].focus();
  });
  globalThis.addEventListener?.("resize", show);
  show();
  return panels;
}

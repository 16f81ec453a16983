/** Elements without markup: text from anywhere is only ever text. */

/**
 * Make an element and append it.
 *
 * @param {object} [options] `text`, `className`, `on` (listeners by event); all else becomes an attribute: true is "",
 *   false and null leave it out
 * @returns {Element}
 */
export function add(parent, tag, {text, className, on = {}, ...attributes} = {}) {
  const element = parent.ownerDocument.createElement(tag);
  if (className !== undefined) element.className = className;
  if (text !== undefined) element.textContent = text;
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== false && value !== null && value !== undefined) element.setAttribute(name, value === true ? "" : value);
  }
  for (const [event, listener] of Object.entries(on)) element.addEventListener(event, listener);
  parent.append(element);
  return element;
}

/** Make an element of a drawing and append it; `svg` begins one. */
export function addDrawing(parent, tag, attributes = {}) {
  const element = parent.ownerDocument.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  parent.append(element);
  return element;
}

/** Make a button; `type` is button, so that no form is ever sent. */
export function button(parent, text, onClick, options = {}) {
  return add(parent, "button", {text, type: "button", ...options, on: {click: onClick, ...options.on}});
}

/** Set a text only where it has changed: 25 times a second, and a screen reader speaks each change. */
export function setText(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

/** Remove all children. */
export function clear(element) {
  element.replaceChildren();
}

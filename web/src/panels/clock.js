/** The browser's own clock and timers; tests give others in their place. */

/** `now()` [ms], monotonic; `time()`, the time of day in words; `every(ms, call)`; `frame(call)`, before the next picture is drawn. */
export const browser = {
  now: () => performance.now(),
  time: () => new Date().toLocaleTimeString(),
  // a program of tests does not wait for it
  every: (ms, call) => setInterval(call, ms).unref?.(),
  frame: (call) => requestAnimationFrame(call),
};

/**
 * What is drawn of one robot: twin, measured arm, plan, goal, scene, building model, markers; with a camera of its own.
 *
 * Joint values are applied at once when a message comes; drawing waits for the next frame.
 */
import {AmbientLight, DirectionalLight, HemisphereLight, Object3D, PerspectiveCamera, Raycaster, Scene, Vector2, Vector3} from "three";
import {OrbitControls} from "three/addons/controls/OrbitControls.js";
import {TransformControls} from "three/addons/controls/TransformControls.js";
import * as colours from "./colours.js";
import {ghostOf, loadRobot, ModelError, setJoints, toolOf} from "./robot_model.js";
import {closestMarker, colourBuilding, dispose, floor, ghostMaterial, loadBuilding, pathLine, reachMarker, sceneBody} from "./shapes.js";

/** Directions from which the cell is looked at: unit vectors towards the camera. */
const VIEWS = {home: [0.72, -0.6, 0.42], front: [1, 0, 0.12], side: [0, -1, 0.12], top: [0.001, 0, 1]};
/** A finger that moved less than this [px] has tapped. */
const TAP = 8;
/** Wait before a model that could not be loaded is asked for again [ms]. */
const RETRY = 5000;

/** Views that change nothing are drawn so often [ms]: what was overlooked is not for long. */
const AT_LEAST_EVERY = 1000;
/** For JSON: what is farther behind the decimal point than 10 µrad and 10 µm nobody sees. */
const rounded = (key, value) => (typeof value === "number" ? Math.round(1e5 * value) : value);

/**
 * Make the cell of a robot.
 *
 * @param {string} name
 * @param {Element} overlay transparent, above its part of the picture: takes the gestures
 * @param {object} store
 * @param {() => void} redraw
 */
export function makeCell(name, overlay, store, redraw) {
  const scene = new Scene();
  const camera = new PerspectiveCamera(42, 1, 0.05, 100);
  camera.up.set(0, 0, 1);
  const controls = new OrbitControls(camera, overlay);
  controls.maxDistance = 30;
  controls.minDistance = 0.3;
  controls.maxPolarAngle = Math.PI * 0.55;
  controls.addEventListener("change", redraw);
  // the view that was chosen; "" once the person has turned or moved it by hand
  let chosen = "home";
  controls.addEventListener("start", () => {
    chosen = "";
  });
  const sun = new DirectionalLight(0xffffff, 1.6);
  sun.position.set(3, -4, 6);
  scene.add(new HemisphereLight(0xffffff, 0x777780, 1.4), new AmbientLight(0xffffff, 0.35), sun);

  const state = {loading: null, progress: null, failed: "", lacks: "", stale: false, missing: []};
  // views come 25 times a second: a model that could not be loaded is not asked for with each of them
  let resting = false;
  const ghosts = {
    arm: ghostMaterial(...colours.UNKNOWN_SYNC, true), plan: ghostMaterial(colours.PLAN, 0.55, false),
    goal: ghostMaterial(colours.GOAL, 0.4, false),
  };
  let bodies = null;
  let template = null;
  let grid = null;
  let path = null;
  let building = null;
  let buildingOf = "";
  let sceneKey = "";
  let drawnView = "";
  let drawnAt = -AT_LEAST_EVERY;
  const objects = [];
  const closest = closestMarker();
  const reach = reachMarker();
  scene.add(closest, reach);
  let ended = false;

  // -- the handle by which the goal is dragged

  const handle = new Object3D();
  scene.add(handle);
  const gizmo = new TransformControls(camera, overlay);
  gizmo.setSpace("local");
  gizmo.setSize(0.9);
  scene.add(gizmo.getHelper());
  gizmo.getHelper().visible = false;
  gizmo.enabled = false;
  gizmo.addEventListener("change", redraw);
  gizmo.addEventListener("dragging-changed", ({value}) => {
    controls.enabled = !value;
    if (!value) tellDrag(true);
  });
  gizmo.addEventListener("objectChange", () => tellDrag(false));

  function tellDrag(done) {
    store.set("drag", name, {position: handle.position.toArray(), quaternion: handle.quaternion.toArray(), done});
  }

  function showHandle(value) {
    const there = value !== null && replayed() === null;
    if (there && !gizmo.dragging) {
      handle.position.fromArray(value.position);
      handle.quaternion.fromArray(value.quaternion);
    }
    if (there && gizmo.object === undefined) gizmo.attach(handle);
    if (!there && gizmo.object !== undefined) gizmo.detach();
    gizmo.enabled = there;
    gizmo.getHelper().visible = there;
    redraw();
  }

  // -- model

  async function load() {
    if (template !== null || state.loading !== null || resting || ended) return;
    state.failed = "";
    const done = (async () => {
      template = await loadRobot(`/private/${encodeURIComponent(name)}/robot.urdf`, (loaded, all) => {
        state.progress = {done: loaded, all};
        redraw();
      });
      bodies = {twin: template, arm: ghostOf(template, ghosts.arm), plan: ghostOf(template, ghosts.plan), goal: ghostOf(template, ghosts.goal)};
      for (const body of Object.values(bodies)) {
        body.visible = false;
        scene.add(body);
      }
    })();
    state.loading = done;
    try {
      await done;
      showAll();
    } catch (error) {
      template = null;
      // a file that is there and cannot be read throws what its reader likes
      state.failed = error instanceof ModelError ? error.message : `${error.name}: ${error.message}`;
      resting = true;
      setTimeout(() => {
        resting = false;
        if (store.robot(name)?.view) load();
      }, RETRY);
    } finally {
      state.loading = null;
      state.progress = null;
      redraw();
    }
  }

  /** Load the building model that tasks are of, by the model's hash. A file of another model is not taken: it may be an old one. */
  async function loadModel(hash) {
    if (buildingOf === hash || ended) return;
    buildingOf = hash;
    try {
      const loaded = await loadBuilding(`/private/${encodeURIComponent(name)}/building.glb`);
      if (buildingOf !== hash || ended) return;
      state.lacks = "";
      state.stale = loaded.hash !== hash;
      if (!state.stale) {
        building = loaded;
        scene.add(building.group);
        showTasks();
        return;
      }
    } catch (error) {
      state.lacks = error instanceof ModelError ? error.message : `${error.name}: ${error.message}`;
    }
    redraw();
    setTimeout(() => {
      // another model may be worked on meanwhile
      if (buildingOf !== hash) return;
      buildingOf = "";
      showTasks();
    }, RETRY);
  }

  function dropModel() {
    if (building !== null) dispose(building.group);
    building = null;
    buildingOf = "";
    state.stale = false;
  }

  // -- what the store knows

  const robot = () => store.robot(name);

  /** What is shown of a recording in place of the present. */
  const replayed = () => robot()?.replay ?? null;

  function pose(body, names, positions) {
    if (bodies === null) return;
    state.missing = setJoints(bodies[body], names, positions);
    bodies[body].visible = true;
  }

  function showView(view) {
    if (replayed() !== null) return;
    if (view !== null) {
      load();
      const {names} = view.joints;
      if (bodies !== null) {
        // the last pose stays, drawn as old
        if (view.twin !== null) pose("twin", names, view.twin.positions);
        if (view.arm !== null) pose("arm", names, view.arm.positions);
        bodies.arm.visible = view.arm !== null;
        colourArm(view.sync?.state);
      }
    } else if (bodies !== null) {
      bodies.arm.visible = false;
    }
    closest.show(view?.closest ?? null);
    // views come 25 times a second; while the robot stands still they all show the same picture
    const shown = view === null ? "" : JSON.stringify(
      [view.twin?.positions, view.arm?.positions, view.sync?.state, view.closest, bodies !== null], rounded);
    const at = performance.now();
    if (shown === drawnView && at - drawnAt < AT_LEAST_EVERY) return;
    drawnView = shown;
    drawnAt = at;
    redraw();
  }

  function showPlan() {
    const plan = robot()?.plan ?? null;
    if (path !== null) dispose(path);
    path = null;
    // nothing is shown of a plan that is not what its hash says
    if (plan !== null && plan.refused === "" && replayed() === null) {
      path = pathLine(plan.tool_path, plan.segments ?? []);
      scene.add(path);
    }
    showGoal();
  }

  function showGoal() {
    const {goal, plan} = robot() ?? {goal: null, plan: null};
    const planned = plan !== null && plan.refused === "";
    const shown = replayed() !== null ? null : goal ?? (planned ? {names: plan.joints, positions: plan.goal} : null);
    if (bodies !== null) {
      bodies.goal.visible = shown !== null;
      ghosts.goal.color.set(goal?.reach ? colours.BY_REACH[goal.reach] ?? colours.GOAL : colours.GOAL);
      if (shown !== null) pose("goal", shown.names, shown.positions);
    }
    reach.visible = Boolean(goal?.reach) && bodies !== null && shown !== null;
    if (reach.visible) {
      reach.material.color.set(colours.BY_REACH[goal.reach] ?? colours.BY_REACH.unknown);
      const at = robot()?.handle;
      if (at) {
        reach.position.fromArray(at.position);
      } else {
        bodies.goal.updateWorldMatrix(true, true);
        toolOf(bodies.goal).getWorldPosition(reach.position);
      }
    }
    redraw();
  }

  function showPlayback() {
    const playback = replayed() === null ? robot()?.playback ?? null : null;
    if (bodies !== null) {
      bodies.plan.visible = playback !== null;
      if (playback !== null) pose("plan", playback.names, playback.positions);
    }
    redraw();
  }

  function showScene() {
    const message = robot()?.scene ?? null;
    const key = message === null ? "" : `${message.hash} ${bodies !== null}`;
    // a scene is large and is sent again at each connection
    if (key !== "" && key === sceneKey) return;
    sceneKey = key;
    while (objects.length) dispose(objects.pop());
    for (const object of message?.objects ?? []) {
      const body = sceneBody(object, (error) => {
        if (error) state.lacks = error.message;
        redraw();
      });
      const carrier = object.link && bodies?.twin.links[object.link];
      if (object.link && !carrier) continue;
      (carrier || scene).add(body);
      objects.push(body);
    }
    redraw();
  }

  function showTasks() {
    const tasks = robot()?.tasks ?? null;
    if (tasks === null) {
      // without tasks nobody looks at a model that has not come yet; one that is there stays, without their colours
      if (building === null) dropModel();
    } else {
      if (buildingOf !== "" && buildingOf !== tasks.model_hash) dropModel();
      if (tasks.tasks.length) loadModel(tasks.model_hash);
    }
    if (building !== null) colourBuilding(building, tasks, robot()?.picked?.element ?? "");
    redraw();
  }

  let replaying = false;
  /** Show a recording's poses, and nothing of the present's plan and goal; or the present again. */
  function showReplay(replay) {
    if (replaying !== (replay !== null)) {
      replaying = replay !== null;
      drawnView = "";
      showAll();
    }
    if (replay === null) return;
    load();
    closest.show(null);
    if (bodies === null) return;
    for (const body of ["twin", "arm"]) {
      if (replay[body] !== null) pose(body, replay.names, replay[body]);
      bodies[body].visible = replay[body] !== null;
    }
    colourArm(replay.sync);
    redraw();
  }

  function colourArm(sync) {
    const [colour, opacity] = colours.BY_SYNC[sync] ?? colours.UNKNOWN_SYNC;
    ghosts.arm.color.set(colour);
    ghosts.arm.opacity = opacity;
  }

  function showAll() {
    if (replayed() !== null) showReplay(replayed());
    showView(robot()?.view ?? null);
    showPlan();
    showPlayback();
    showScene();
    showTasks();
    showHandle(robot()?.handle ?? null);
  }

  const mine = (listener) => (whose, value) => {
    if (whose === name) listener(value);
  };
  const ends = [
    store.on("view", mine(showView)), store.on("plan", mine(showPlan)), store.on("goal", mine(showGoal)),
    store.on("playback", mine(showPlayback)), store.on("scene", mine(showScene)), store.on("tasks", mine(showTasks)),
    store.on("picked", mine(showTasks)), store.on("handle", mine(showHandle)), store.on("replay", mine(showReplay)),
  ];

  // -- taps

  let pressed = null;
  overlay.addEventListener("pointerdown", (event) => {
    pressed = event.isPrimary ? [event.clientX, event.clientY] : null;
  });
  overlay.addEventListener("pointerup", (event) => {
    if (pressed === null || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > TAP || gizmo.dragging) return;
    store.select(name);
    const box = overlay.getBoundingClientRect();
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2((event.clientX - box.left) / box.width * 2 - 1, 1 - (event.clientY - box.top) / box.height * 2), camera);
    const targets = [...objects, ...building === null ? [] : [building.group]];
    const hit = ray.intersectObjects(targets, true)[0];
    if (!hit) return;
    let object = "";
    for (let each = hit.object; each !== null; each = each.parent) object ||= each.userData.object ?? "";
    store.set("tap", name, {element: hit.object.userData.tapped ?? "", object});
  });

  // -- cameras

  function look(view) {
    chosen = view;
    const centre = new Vector3(0.3, 0, 1.0);
    let distance = 5.4 / Math.min(1, Math.max(0.45, camera.aspect));
    let direction = VIEWS[view];
    if (view === "tool" && bodies !== null) {
      bodies.twin.updateWorldMatrix(true, true);
      toolOf(bodies.twin).getWorldPosition(centre);
      distance = 1.8;
      direction = VIEWS.home;
    }
    controls.target.copy(centre);
    camera.position.set(...direction ?? VIEWS.home).normalize().multiplyScalar(distance).add(centre);
    controls.update();
    redraw();
  }

  /** Where a point is in this robot's part of the picture: fractions from its upper left corner. */
  function onScreen(point) {
    const projected = point.clone().project(camera);
    return [(projected.x + 1) / 2, (1 - projected.y) / 2];
  }

  /** The way on the picture of the handle's own z axis, of a quarter of a metre. */
  function screenAxis() {
    const [x, y] = onScreen(handle.position);
    const [u, v] = onScreen(new Vector3(0, 0, 0.25).applyQuaternion(handle.quaternion).add(handle.position));
    return [u - x, v - y];
  }

  const toolPosition = (body) => {
    if (bodies === null || !bodies[body].visible) return null;
    bodies[body].updateWorldMatrix(true, true);
    return toolOf(bodies[body]).getWorldPosition(new Vector3()).toArray();
  };

  look("home");
  showAll();

  return {
    name, scene, camera, state, look,
    /** Whether the handle moves the tool or turns it. */
    get turns() {
      return gizmo.mode === "rotate";
    },
    set turns(value) {
      gizmo.setMode(value ? "rotate" : "translate");
    },
    get ready() {
      return bodies !== null;
    },
    /** Fit the camera to its part of the picture. */
    resize(width, height) {
      camera.aspect = width / height;
      camera.updateProjectionMatrix();
      if (chosen !== "") look(chosen);
    },
    /** Take the colours of the theme. */
    theme(gridColour) {
      if (grid !== null) dispose(grid);
      grid = floor(gridColour);
      scene.add(grid);
    },
    /** What is drawn now, for tests: joint values and positions of the tool by body, and the path's points. */
    inspect() {
      const values = (body) => (bodies === null || !bodies[body].visible ? null
        : Object.fromEntries(Object.values(bodies[body].joints).filter((joint) => joint.jointType !== "fixed")
          .map((joint) => [joint.name ?? joint.urdfName, joint.angle])));
      const result = {ready: bodies !== null, failed: state.failed, lacks: state.lacks, stale: state.stale, seq: robot()?.view?.seq ?? null};
      for (const body of ["twin", "arm", "plan", "goal"]) result[body] = {joints: values(body), tool: toolPosition(body)};
      result.path = path === null ? null : robot()?.plan?.tool_path ?? null;
      result.armColour = ghosts.arm.color.getHex();
      result.objects = objects.map((each) => each.name);
      result.elements = building === null ? [] : [...building.elements].map(([element, {material}]) => [element, material.color.getHex()]);
      result.handle = gizmo.object === undefined ? null
        : {position: handle.position.toArray(), screen: onScreen(handle.position), axis: screenAxis(), mode: gizmo.mode};
      result.camera = {position: camera.position.toArray(), target: controls.target.toArray()};
      result.replay = replayed()?.time ?? null;
      result.closest = closest.visible;
      result.reach = reach.visible ? reach.material.color.getHex() : null;
      return result;
    },
    end() {
      ended = true;
      for (const stop of ends) stop();
      controls.dispose();
      gizmo.dispose();
      dispose(scene);
    },
  };
}

/**
 * What is drawn of one robot: twin, measured arm, plan, goal, scene, building model, markers, floor; with a camera of
 * its own.
 *
 * Joint values are applied at once when a message comes; drawing waits for the next frame. The camera is fitted to all
 * that is there until the person moves it.
 */
import {Box3, Raycaster, Scene, Vector2, Vector3} from "three";
import {clock} from "../progress.js";
import {makeCamera} from "./camera.js";
import {closestOf, millimetres} from "./closest.js";
import * as colours from "./colours.js";
import {around, clipped, corners} from "./fit.js";
import {floorOf, makeFloor, makeLight} from "./floor.js";
import {playedOf} from "./played.js";
import {ghostOf, loadRobot, mainColour, reachOf, reasonOf, setJoints, toolOf} from "./robot_model.js";
import {axes, colourBuilding, cornersOf, dispose, ghostMaterial, isEngaged, loadBuilding, markerBall, pathLine, playedPath, sceneBody} from "./shapes.js";

/** What is farther away than so many times the arm's reach does not move the camera away. */
const FAR = 2.2;
/** Reach of an arm whose model has not come yet [m]. */
const REACH = 2.5;
/** So much is shown on all sides of an element that is brought into view, and of the tool, as parts of the arm's reach. */
const AROUND = 0.2;
const AROUND_TOOL = 0.22;
/** Length of the tool frame's axes, as a part of the arm's reach. */
const AXES = 0.1;
/** Radius of the ball that marks the closest point [m]. */
const CLOSEST_BALL = 0.03;
/** Joint values that differ by less show the same picture [rad], [m]. */
const SAME = 1e-3;
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
 * @param {Element} overlay transparent, above its part of the picture: takes the gestures
 * @param {number} [ratio] pixels of the screen by pixel of the page
 */
export function makeCell(name, overlay, store, redraw, ratio = 1) {
  const scene = new Scene();
  const ground = makeFloor();
  scene.add(ground);
  const camera = makeCamera(overlay, ground, redraw);
  const light = makeLight(scene);

  const state = {progress: null, failed: "", unread: "", lacks: "", stale: false, missing: []};
  let loading = false;
  // views come 25 times a second: a model that could not be loaded is not asked for with each of them
  let resting = false;
  const ghosts = {
    arm: ghostMaterial(...colours.UNKNOWN_SYNC, true), plan: ghostMaterial(colours.PLAN, 0.55, false),
    goal: ghostMaterial(colours.GOAL, 0.4, false),
  };
  let bodies = null;
  let template = null;
  let path = null;
  let reachable = REACH;
  let twinColour = null;
  let tapped = null;
  let near = null;
  // whether the arm as measured is known; where it stands in the twin, it is hidden by it
  const there = {arm: false};
  let covered = false;
  let building = null;
  let buildingOf = "";
  let sceneKey = "";
  let drawnView = "";
  let drawnAt = -AT_LEAST_EVERY;
  let height = 0;
  const objects = [];
  const closest = markerBall(CLOSEST_BALL, colours.CLOSEST);
  const playedLine = playedPath();
  scene.add(closest, playedLine);
  let played = null;
  let playedId = "";

  // -- model

  async function load() {
    if (template !== null || loading || resting) return;
    state.failed = "";
    loading = true;
    try {
      const loaded = await loadRobot(`private/${encodeURIComponent(name)}/robot.urdf`, (done, all) => {
        state.progress = {done, all};
        redraw();
      });
      template = loaded.robot;
      state.unread = loaded.lacks.join("; ");
      twinColour = mainColour(template);
      bodies = {twin: template, arm: ghostOf(template, ghosts.arm), plan: ghostOf(template, ghosts.plan), goal: ghostOf(template, ghosts.goal)};
      reachable = reachOf(template) || REACH;
      template.traverse((child) => {
        if (child.isMesh) child.castShadow = child.receiveShadow = true;
      });
      toolOf(template).add(axes(AXES * reachable));
      for (const body of Object.values(bodies)) {
        body.visible = false;
        scene.add(body);
      }
      showAll();
      refit();
    } catch (error) {
      template = null;
      state.failed = reasonOf(error);
      resting = true;
      setTimeout(() => {
        resting = false;
        if (store.robot(name)?.view) load();
      }, RETRY);
    } finally {
      loading = false;
      state.progress = null;
      redraw();
    }
  }

  /** Load the building model of this hash; an older file is ignored, and loaded again later. */
  async function loadModel(hash) {
    if (buildingOf === hash) return;
    buildingOf = hash;
    try {
      const loaded = await loadBuilding(`private/${encodeURIComponent(name)}/building.glb`);
      if (buildingOf !== hash) return;
      state.lacks = "";
      state.stale = loaded.hash !== hash;
      if (!state.stale) {
        building = loaded;
        scene.add(building.group);
        showTasks();
        refit();
        return;
      }
    } catch (error) {
      state.lacks = reasonOf(error);
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
    state.lacks = "";
  }

  // -- what the store knows

  const robot = () => store.robot(name);

  function pose(body, names, positions) {
    if (bodies === null) return;
    state.missing = setJoints(bodies[body], names, positions);
    bodies[body].visible = true;
  }

  function showView(view) {
    if (view !== null) {
      load();
      const {names} = view.joints;
      if (bodies !== null) {
        // the last pose stays, drawn as old
        if (view.twin !== null) pose("twin", names, view.twin.positions);
        if (view.arm !== null) pose("arm", names, view.arm.positions);
        const agree = colourArm(view.sync?.state);
        there.arm = view.arm !== null;
        covered = agree && view.twin !== null && view.arm !== null
          && view.arm.positions.every((value, k) => Math.abs(value - view.twin.positions[k]) < SAME);
        bodies.arm.visible = there.arm && !covered;
      }
    } else if (bodies !== null) {
      there.arm = bodies.arm.visible = false;
    }
    showClosest();
    showPlayed();
    if (camera.chosen !== "" && isOutside()) refit();
    // views come 25 times a second; while the robot stands still they all show the same picture
    const shown = view === null ? "" : JSON.stringify(
      [view.twin?.positions, view.arm?.positions, view.sync?.state, bodies !== null, played?.travelled.at(-1), played?.remaining], rounded);
    const at = performance.now();
    if (shown === drawnView && at - drawnAt < AT_LEAST_EVERY) return;
    drawnView = shown;
    drawnAt = at;
    redraw();
  }

  function showClosest() {
    near = closestOf(robot());
    closest.visible = near !== null;
    if (near !== null) closest.position.fromArray(near.point);
  }

  /** Show where the tool goes by the plan that is played. */
  function showPlayed() {
    const before = played;
    played = playedOf(robot());
    if (played === null && before === null) return;
    playedLine.show(played);
    const id = played === null ? "" : robot().path.plan_id;
    // who comes in the middle of a motion has seen no plan that the camera was fitted to
    if (id !== playedId && id !== "") refit();
    if (id !== playedId) redraw();
    playedId = id;
  }

  function showPlan() {
    const plan = robot()?.plan ?? null;
    if (path !== null) dispose(path);
    path = null;
    // nothing is shown of a plan that is not what its hash says
    if (plan !== null && plan.refused === "") {
      path = pathLine(plan.tool_path, plan.segments ?? [], ratio);
      scene.add(path);
    }
    showClosest();
    showGoal();
    if (path !== null) refit();
  }

  function showGoal() {
    const {goal, plan} = robot() ?? {goal: null, plan: null};
    const planned = plan !== null && plan.refused === "";
    const shown = goal ?? (planned ? {names: plan.joints, positions: plan.goal} : null);
    if (bodies !== null) {
      bodies.goal.visible = shown !== null;
      if (shown !== null) pose("goal", shown.names, shown.positions);
    }
    redraw();
  }

  function showPlayback() {
    const playback = robot()?.playback ?? null;
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
    tapped = null;
    const standing = floorOf(message?.objects ?? []);
    height = standing?.height ?? 0;
    for (const object of message?.objects ?? []) {
      const body = sceneBody(object, (error) => {
        if (error) state.lacks = error.message;
        redraw();
      });
      const carrier = object.link && bodies?.twin.links[object.link];
      if (object.link && !carrier) continue;
      (carrier || scene).add(body);
      // the floor of the scene is the floor of the picture
      body.visible = object.name !== standing?.name;
      body.userData.carried = Boolean(object.link);
      objects.push(body);
    }
    refit();
    redraw();
  }

  /** Show which element is worked on, in view: who has chosen it in the list may look somewhere else. */
  function showPicked(picked) {
    showTasks();
    const node = building?.elements.get(picked?.element ?? "")?.node;
    // what was tapped in the picture is in view
    if (node === undefined || tapping) return;
    const centre = new Box3().setFromObject(node).getCenter(new Vector3());
    if (!camera.isInView(centre)) camera.lookAt([...cornersOf(node), ...boxAround(centre, AROUND)]);
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

  function colourArm(sync) {
    const [colour, opacity] = colours.BY_SYNC[sync] ?? colours.UNKNOWN_SYNC;
    ghosts.arm.color.set(colour);
    ghosts.arm.opacity = opacity;
    // while both agree the twin has its own colours, and what is seen of the arm is where it is beside it
    const agree = sync === "IN_SYNC";
    ghosts.arm.polygonOffsetFactor = ghosts.arm.polygonOffsetUnits = agree ? 1 : -1;
    return agree;
  }

  function showAll() {
    showView(robot()?.view ?? null);
    showPlayed();
    showPlan();
    showPlayback();
    showScene();
    showTasks();
  }

  for (const [kind, show] of Object.entries({
    view: showView, plan: showPlan, path: showPlayed, goal: showGoal, playback: showPlayback, scene: showScene, tasks: showTasks,
    picked: showPicked,
  })) {
    store.on(kind, (whose, value) => {
      if (whose === name) show(value);
    });
  }

  // -- taps

  let pressed = null;
  let tapping = false;
  overlay.addEventListener("pointerdown", (event) => {
    pressed = event.isPrimary ? [event.clientX, event.clientY] : null;
  });
  overlay.addEventListener("pointerup", (event) => {
    if (pressed === null || Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) > TAP) return;
    store.select(name);
    const box = overlay.getBoundingClientRect();
    tap(event.clientX - box.left, event.clientY - box.top, box.width, box.height);
  });

  /** Take a tap on this part of the picture [px]. */
  function tap(x, y, width, tall) {
    const ray = new Raycaster();
    ray.setFromCamera(new Vector2(x / width * 2 - 1, 1 - y / tall * 2), camera.perspective);
    const targets = [...objects, ...building === null ? [] : [building.group]];
    const hit = ray.intersectObjects(targets, true).find(({object}) => object.isMesh);
    tapped = null;
    redraw();
    if (!hit) return;
    let object = "";
    for (let each = hit.object; each !== null; each = each.parent) object ||= each.userData.object ?? "";
    tapped = {object, element: hit.object.userData.tapped ?? ""};
    tapping = true;
    store.set("tap", name, {element: tapped.element, object});
    tapping = false;
  }

  // -- cameras

  /** Return points around all that is drawn: arm, what it reaches, plan, scene and building model; not what is far away from it. */
  function content() {
    const points = around(reachable).map(([x, y]) => [x, y, ground.position.z]);
    if (bodies === null) points.push([0, 0, 0.9 * reachable]);
    else for (const body of Object.values(bodies)) if (body.visible) points.push(...cornersOf(body));
    if (path !== null) points.push(...robot().plan.tool_path);
    if (played !== null) points.push(...robot().path.tool_path);
    for (const body of objects) if (body.visible) points.push(...cornersOf(body));
    if (building !== null) points.push(...cornersOf(building.group));
    return clipped(points, FAR * reachable);
  }

  /** Whether the twin's tool is where the camera was not fitted to. */
  function isOutside() {
    if (bodies === null || fitted.isEmpty()) return false;
    return !fitted.containsPoint(toolAt("twin"));
  }

  const fitted = new Box3();

  /** Fit floor and camera to what is there now; the camera only while no person has moved it. */
  function refit() {
    const points = content();
    fitted.setFromPoints(points.map((point) => new Vector3(...point))).expandByScalar(0.1 * reachable);
    ground.cover(points, height);
    light.cover(fitted);
    if (!["", "tool"].includes(camera.chosen)) look(camera.chosen, points);
    redraw();
  }

  function look(chosen, points = content()) {
    camera.look(chosen, chosen === "tool" && bodies !== null ? boxAround(toolAt("twin"), AROUND_TOOL) : points);
  }

  /** Return the corners of a box around a point; `size`: to each side, as a part of the arm's reach. */
  function boxAround(centre, size) {
    const [low, high] = [-size, size].map((side) => centre.clone().addScalar(side * reachable).toArray());
    return corners(low, high);
  }

  /** Return where the tool of a body is. */
  function toolAt(body) {
    bodies[body].updateWorldMatrix(true, true);
    return toolOf(bodies[body]).getWorldPosition(new Vector3());
  }

  // -- words in the picture

  /** Return the words that belong to a place in the picture [px], the more important with a higher rank. */
  function labels(width, tall) {
    const found = [];
    const at = (point, text, kind, rank) => {
      const {x, y, z} = camera.onScreen(point);
      if (Math.abs(z) <= 1) found.push({text, kind, rank, x: x * width, y: y * tall});
    };
    if (near !== null) at(new Vector3(...near.point), `${millimetres(near.distance)} mm`, "closest", 90);
    if (played !== null && played.remaining !== null) at(new Vector3(...played.end), clock(played.remaining), "left", 95);
    // what was tapped or picked has its name
    const picked = building?.elements.get(robot()?.picked?.element || tapped?.element);
    const body = picked?.node ?? objects.find((each) => each.visible && each.name === tapped?.object);
    const box = body && new Box3().setFromObject(body);
    if (box && !box.isEmpty()) at(box.getCenter(new Vector3()).setZ(box.max.z), picked?.label ?? body.name, "name", 80);
    return found;
  }

  /** Where the axes at the tool are drawn, and which way each of them points; null: they are not. */
  function toolFrame() {
    if (bodies === null || !bodies.twin.visible) return null;
    bodies.twin.updateWorldMatrix(true, true);
    const {elements} = toolOf(bodies.twin).getObjectByName("axes").matrixWorld;
    return {position: elements.slice(12, 15), axes: [0, 4, 8].map((k) => elements.slice(k, k + 3))};
  }

  showAll();
  refit();

  return {
    name, scene, camera: camera.perspective, state, look, labels,
    get ready() {
      return bodies !== null;
    },
    resize(width, tall, covered) {
      camera.resize(width, tall, covered);
      // what a person has chosen stays, at another size too
      if (camera.chosen !== "") look(camera.chosen);
    },
    /** Take the colours of the theme: of the floor and of its lines. */
    theme: ground.theme,
    /** Draw shadows, or none. */
    shadows(on) {
      light.shadows(on);
      ground.shadows(on);
      redraw();
    },
    /** What is drawn now, in which colours, for the legend. */
    drawn() {
      const is = (body) => bodies !== null && bodies[body].visible;
      const plan = robot()?.plan ?? null;
      const segments = path === null ? [] : plan.segments ?? [];
      const engaged = path === null ? [] : plan.tool_path.map((_, k) => isEngaged(segments, k));
      const some = (carried) => objects.some((each) => each.visible && each.userData.carried === carried);
      return {
        twin: is("twin") && !covered ? twinColour : null,
        // one body is seen where both agree to the width of a line
        both: covered && is("twin") ? twinColour : null,
        arm: is("arm") ? ghosts.arm.color.getHex() : null,
        plan: is("plan") ? colours.PLAN : null,
        goal: is("goal") ? colours.GOAL : null,
        path: path !== null && engaged.includes(false) ? colours.PATH : null,
        engaged: engaged.includes(true) ? colours.PATH_ENGAGED : null,
        ahead: played?.ahead.length ? colours.AHEAD : null,
        travelled: played?.travelled.length ? colours.TRAVELLED : null,
        closest: closest.visible ? {...near, colour: colours.CLOSEST} : null,
        tool: is("twin") ? colours.AXES[0] : null,
        carried: some(true) ? colours.CARRIED : null,
        standing: some(false) ? colours.STANDING : null,
        elements: building === null ? [] : [...building.elements.values()].map(({material}) => material.color.getHex()),
      };
    },
    /** What is drawn now, for tests: joint values and positions of the tool by body, and the path's points. */
    inspect() {
      const isShown = (body) => bodies !== null && (body === "arm" ? there.arm : bodies[body].visible);
      const values = (body) => (!isShown(body) ? null
        : Object.fromEntries(Object.values(bodies[body].joints).filter((joint) => joint.jointType !== "fixed")
          .map((joint) => [joint.name ?? joint.urdfName, joint.angle])));
      const result = {ready: bodies !== null, failed: state.failed, unread: state.unread, lacks: state.lacks, stale: state.stale, seq: robot()?.view?.seq ?? null};
      for (const body of ["twin", "arm", "plan", "goal"]) result[body] = {joints: values(body), tool: isShown(body) ? toolAt(body).toArray() : null};
      result.path = path === null ? null : robot()?.plan?.tool_path ?? null;
      result.waypoints = path === null ? 0 : path.userData.waypoints;
      result.played = played;
      result.armColour = ghosts.arm.color.getHex();
      result.objects = objects.map((each) => each.name);
      result.elements = building === null ? [] : [...building.elements].map(([element, {material}]) => [element, material.color.getHex()]);
      result.places = building === null ? {} : Object.fromEntries([...building.elements].map(([element, {node}]) => {
        const {x, y} = camera.onScreen(new Box3().setFromObject(node).getCenter(new Vector3()));
        return [element, [x, y]];
      }));
      result.camera = camera.inspect();
      result.closest = closest.visible ? near : null;
      result.floor = {height: ground.position.z, half: ground.userData.half};
      result.frame = toolFrame();
      return result;
    },
  };
}

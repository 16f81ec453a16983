#!/usr/bin/env bash
# Gazebo 11 for a Debian 12 or 13 machine, which has none: a chroot with Debian 11 under .ws/gazebo, and the plugin built in it.
# The ROS master and all nodes stay outside. As root; 4 to 6 minutes and 2.3 GB the first time (scripts/chroot.sh).
#
#   scripts/gazebo_chroot.sh make           chroot, packages, plugin; quick when nothing changed
#   scripts/gazebo_chroot.sh run COMMAND    run a command in there; files of this machine have the same paths
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
name=gazebo place="$root/.ws/gazebo" suite=bullseye
packages="ca-certificates cmake g++ gazebo libgazebo-dev libroscpp-dev libsensor-msgs-dev make"
mounts="/root /home $root ${ROS_HOME:-/tmp}"
build="$place/build"
source "$root/scripts/chroot.sh"

build_plugin() {
  (inside sh -c "cmake -S '$root/gazebo' -B '$build' -DCMAKE_BUILD_TYPE=Release && cmake --build '$build'") >"$place/build.log" 2>&1 ||
    fail "the plugin could not be built: $(tail -n 5 "$place/build.log" | tr '\n' ' ') (all of it: $place/build.log)"
  [ -e "$build/libconstruction_twin_gazebo.so" ] || fail "CMake found no Gazebo in the chroot (all of it: $place/build.log)"
}

case "${1:-}" in
  make)
    make_system
    build_plugin
    say "ready: $build/libconstruction_twin_gazebo.so"
    ;;
  run)
    [ -e "$place/.packages" ] || fail "there is no chroot yet: scripts/gazebo_chroot.sh make"
    shift
    # Python and libraries of this machine's ROS are not those of the chroot
    inside env -u PYTHONPATH PATH=/usr/sbin:/usr/bin:/sbin:/bin LD_LIBRARY_PATH="$build" GAZEBO_PLUGIN_PATH="$build" \
      GAZEBO_MODEL_DATABASE_URI= GAZEBO_IP=127.0.0.1 "$@"
    ;;
  *) usage ;;
esac

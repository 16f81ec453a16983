#!/usr/bin/env bash
# Gazebo 11 for a Debian 12 machine, which has none: a chroot with Debian 11 under .ws/gazebo, and the plugin built in it.
# The ROS master and all nodes stay outside. As root; about 6 minutes and 2.5 GB the first time.
#
#   scripts/gazebo_chroot.sh make           chroot, packages, plugin; quick when nothing changed
#   scripts/gazebo_chroot.sh run COMMAND    run a command in there; files of this machine have the same paths
#
# What it mounts is seen by the command alone and is gone when that ends, so that `make clean` deletes nothing but copies.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
place="$root/.ws/gazebo"
system="$place/root" build="$place/build"
packages="ca-certificates cmake g++ gazebo libgazebo-dev libroscpp-dev libsensor-msgs-dev make"

say() { printf '[gazebo] %s\n' "$*"; }
fail() {
  printf '[gazebo] cannot go on: %s\n' "$*" >&2
  exit 1
}

# $1: a command's words follow. Folders of this machine lie in the chroot at their own paths.
inside() {
  exec env root="$root" unshare --mount --propagation private bash -c '
    set -e
    system=$1; shift
    for folder in /proc /sys /dev /tmp /root /home "$root" "${ROS_HOME:-/tmp}"; do
      [ -d "$folder" ] || continue
      mkdir -p "$system$folder"
      mount --rbind "$folder" "$system$folder"
    done
    [ ! -e /etc/resolv.conf ] || cp -L /etc/resolv.conf "$system/etc/resolv.conf"
    cp /etc/hosts "$system/etc/hosts"
    exec chroot "$system" "$@"' bash "$system" "$@"
}

make_system() {
  [ -e "$place/.packages" ] && [ "$(cat "$place/.packages")" = "$packages" ] && return 0
  command -v debootstrap >/dev/null || apt-get install -y --no-install-recommends debootstrap >"$place/make.log" 2>&1 ||
    fail "debootstrap is missing. As root: apt-get install debootstrap"
  if [ ! -e "$place/.base" ]; then
    say "making a Debian 11 in $system (about 3 minutes)"
    rm -rf "$system"
    debootstrap --variant=minbase bullseye "$system" >"$place/make.log" 2>&1 || fail "debootstrap failed: $(tail -n 2 "$place/make.log" | tr '\n' ' ') (all of it: $place/make.log)"
    touch "$place/.base"
  fi
  say "installing Gazebo 11 in it (about 3 minutes)"
  (inside env DEBIAN_FRONTEND=noninteractive sh -c "apt-get update && apt-get install -y --no-install-recommends $packages && apt-get clean") >"$place/make.log" 2>&1 ||
    fail "apt-get failed: $(tail -n 2 "$place/make.log" | tr '\n' ' ') (all of it: $place/make.log)"
  printf '%s\n' "$packages" >"$place/.packages"
}

build_plugin() {
  (inside sh -c "cmake -S '$root/gazebo' -B '$build' -DCMAKE_BUILD_TYPE=Release && cmake --build '$build'") >"$place/build.log" 2>&1 ||
    fail "the plugin could not be built: $(tail -n 5 "$place/build.log" | tr '\n' ' ') (all of it: $place/build.log)"
  [ -e "$build/libconstruction_twin_gazebo.so" ] || fail "CMake found no Gazebo in the chroot (all of it: $place/build.log)"
}

[ "$(id -u)" -eq 0 ] || fail "a chroot needs root"
case "${1:-}" in
  make)
    mkdir -p "$place"
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
  *)
    sed -n '2,/^set/{/^set/d;s/^# \{0,1\}//;p}' "${BASH_SOURCE[0]}" >&2
    exit 2
    ;;
esac

#!/usr/bin/env bash
# Gazebo 11 for a Debian 12 machine, which has none: a chroot with Debian 11 under .ws/gazebo, and the plugin built in it.
# The ROS master and all nodes stay outside. As root; 4 to 6 minutes and 2.3 GB the first time.
#
#   scripts/gazebo_chroot.sh make           chroot, packages, plugin; quick when nothing changed. Interrupted, by whatever, it goes on
#                                           from the last finished step
#   scripts/gazebo_chroot.sh run COMMAND    run a command in there; files of this machine have the same paths
#
# DEBIAN_MIRROR is where packages are from; without it deb.debian.org, and archive.debian.org once Debian 11 is only there.
# What it mounts is seen by the command alone and is gone when that ends, so that `make clean` deletes nothing but copies.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
place="$root/.ws/gazebo"
system="$place/root" build="$place/build"
mirrors=${DEBIAN_MIRROR:-http://deb.debian.org/debian http://archive.debian.org/debian}
keys=/usr/share/keyrings/debian-archive-keyring.gpg
packages="ca-certificates cmake g++ gazebo libgazebo-dev libroscpp-dev libsensor-msgs-dev make"

say() { printf '[gazebo] %s\n' "$*"; }
fail() {
  printf '[gazebo] cannot go on: %s\n' "$*" >&2
  exit 1
}

# A command's words. Folders of this machine lie in the chroot at their own paths. Environment: unshared, more options of unshare.
inside() {
  # shellcheck disable=SC2086
  exec env root="$root" unshare --mount --propagation private ${unshared:-} bash -c '
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

# Debian 11 into $system. What debootstrap mounts there is gone with its process, however it ends.
make_base() {
  local mirror
  for mirror in $mirrors; do
    say "making a Debian 11 in $system from $mirror (about 3 minutes)"
    rm -rf --one-file-system "$system"
    unshare --mount --propagation private debootstrap --variant=minbase --keyring="$keys" --force-check-gpg bullseye "$system" "$mirror" >"$place/make.log" 2>&1 &&
      touch "$place/.base" && return 0
    say "debootstrap failed: $(tail -n 2 "$place/make.log" | tr '\n' ' ')"
  done
  fail "no Debian 11 from any of: $mirrors (what debootstrap said last: $place/make.log)"
}

make_system() {
  [ -e "$place/.packages" ] && [ "$(cat "$place/.packages")" = "$packages" ] && return 0
  { command -v debootstrap && [ -e "$keys" ]; } >/dev/null || apt-get install -y --no-install-recommends debootstrap debian-archive-keyring >"$place/make.log" 2>&1 ||
    fail "debootstrap or Debian's keys are missing. As root: apt-get install debootstrap debian-archive-keyring"
  [ -e "$place/.base" ] || make_base
  say "installing Gazebo 11 in it (about 3 minutes)"
  # dpkg first finishes what an interrupted run has left half installed. It runs in a session of its own, and would go on alone after a
  # kill: among processes that end together it does not
  (unshared="--pid --fork --kill-child" inside env DEBIAN_FRONTEND=noninteractive sh -c "dpkg --configure -a && apt-get update && apt-get install -y --fix-broken --no-install-recommends -o Acquire::Retries=3 $packages && apt-get clean") >"$place/make.log" 2>&1 ||
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
    # programs of a run that was killed hold it as well, until they end
    exec 9>"$place/.lock"
    flock --timeout 10 9 || fail "another run is still making it, or what it started: wait until that has ended"
    # without this the shell would go on when a program ends on Ctrl-C by itself
    trap 'fail "interrupted; the next make goes on from the last finished step"' INT TERM
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

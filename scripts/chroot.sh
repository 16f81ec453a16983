# Sourced by the scripts that make another Debian in a chroot, which set: root, name, place, suite, packages. As root.
# DEBIAN_MIRROR is where packages are from; without it deb.debian.org, and archive.debian.org once the suite is only there.
# What it mounts is seen by the command alone and is gone when that ends, so that `make clean` deletes nothing but copies.

system="$place/root"
mirrors=${DEBIAN_MIRROR:-http://deb.debian.org/debian http://archive.debian.org/debian}
keys=/usr/share/keyrings/debian-archive-keyring.gpg

say() { printf '[%s] %s\n' "$name" "$*"; }
fail() {
  printf '[%s] cannot go on: %s\n' "$name" "$*" >&2
  exit 1
}

# A command's words. Environment: mounts, the folders of this machine that lie in the chroot at their own paths; unshared, more
# options of unshare.
inside() {
  # shellcheck disable=SC2086
  exec env mounts="/proc /sys /dev /tmp $mounts" unshare --mount --propagation private ${unshared:-} bash -c '
    set -e
    system=$1; shift
    for folder in $mounts; do
      [ -d "$folder" ] || continue
      mkdir -p "$system$folder"
      mount --rbind "$folder" "$system$folder"
    done
    [ ! -e /etc/resolv.conf ] || cp -L /etc/resolv.conf "$system/etc/resolv.conf"
    cp /etc/hosts "$system/etc/hosts"
    exec chroot "$system" "$@"' bash "$system" "$@"
}

# Debian $suite into $system. What debootstrap mounts there is gone with its process, however it ends.
make_base() {
  local mirror
  for mirror in $mirrors; do
    say "making Debian $suite in $system from $mirror (about 3 minutes)"
    rm -rf --one-file-system "$system"
    unshare --mount --propagation private debootstrap --variant=minbase --keyring="$keys" --force-check-gpg "$suite" "$system" "$mirror" >"$place/make.log" 2>&1 &&
      touch "$place/.base" && return 0
    say "debootstrap failed: $(tail -n 2 "$place/make.log" | tr '\n' ' ')"
  done
  fail "no Debian $suite from any of: $mirrors (what debootstrap said last: $place/make.log)"
}

# The chroot with its packages. Interrupted, by whatever, the next call goes on from the last finished step.
make_system() {
  mkdir -p "$place"
  # programs of a run that was killed hold it as well, until they end
  exec 9>"$place/.lock"
  flock --timeout 10 9 || fail "another run is still making it, or what it started: wait until that has ended"
  # without this the shell would go on when a program ends on Ctrl-C by itself
  trap 'fail "interrupted; the next make goes on from the last finished step"' INT TERM
  [ -e "$place/.packages" ] && [ "$(cat "$place/.packages")" = "$packages" ] && return 0
  { command -v debootstrap && [ -e "$keys" ]; } >/dev/null || apt-get install -y --no-install-recommends debootstrap debian-archive-keyring >"$place/make.log" 2>&1 ||
    fail "debootstrap or Debian's keys are missing. As root: apt-get install debootstrap debian-archive-keyring"
  [ -e "$place/.base" ] || make_base
  say "installing packages in it (about 3 minutes)"
  # dpkg first finishes what an interrupted run has left half installed. It runs in a session of its own, and would go on alone after a
  # kill: among processes that end together it does not
  (unshared="--pid --fork --kill-child" inside env DEBIAN_FRONTEND=noninteractive sh -c "dpkg --configure -a && apt-get update && apt-get install -y --fix-broken --no-install-recommends -o Acquire::Retries=3 $packages && apt-get clean") >"$place/make.log" 2>&1 ||
    fail "apt-get failed: $(tail -n 2 "$place/make.log" | tr '\n' ' ') (all of it: $place/make.log)"
  printf '%s\n' "$packages" >"$place/.packages"
}

# The words at the top of the script that sources this.
usage() {
  sed -n '2,/^set/{/^set/d;s/^# \{0,1\}//;p}' "$0" >&2
  exit 2
}

[ "$(id -u)" -eq 0 ] || fail "a chroot needs root"

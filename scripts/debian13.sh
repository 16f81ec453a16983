#!/usr/bin/env bash
# This commit on Debian 13: a chroot under .ws/debian13 with a copy of the repository, in which the words of `make` run.
# As root; 4 to 6 minutes and 4 GB the first time (scripts/chroot.sh).
#
#   scripts/debian13.sh              make demo ARGS="quick:=true", then make test ARGS=unit
#   scripts/debian13.sh WORD...      make WORD... in there, as in: scripts/debian13.sh demo ARGS="quick:=true"
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
name=debian13 place="$root/.ws/debian13" suite=trixie
packages="ca-certificates git make python3 procps"
mounts=/opt
source "$root/scripts/chroot.sh"

# The last commit; .ws of an earlier run stays, so that only the first one installs everything.
copy_repository() {
  local copy="$system/construction_twin"
  [ -d "$copy/.git" ] || git init -q "$copy"
  git -C "$copy" fetch -q "$root" HEAD
  git -C "$copy" checkout -q --force FETCH_HEAD
}

make_in() {
  say "make $*"
  # the certificates that pip and apt use here, and this machine's settings of pip
  (inside env -i HOME=/root PATH=/usr/sbin:/usr/bin:/sbin:/bin LANG=C.UTF-8 $(env | grep -E '^(PIP_|SSL_CERT_FILE=|REQUESTS_CA_BUNDLE=|NODE_EXTRA_CA_CERTS=)') make -C /construction_twin "$@")
}

make_system
copy_repository
cp -L /etc/ssl/certs/ca-certificates.crt "$system/etc/ssl/certs/ca-certificates.crt"
if [ $# -gt 0 ]; then
  make_in "$@"
else
  make_in demo "ARGS=quick:=true"
  make_in test ARGS=unit
fi

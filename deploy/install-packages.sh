#!/bin/sh
# Installs the Debian packages of deploy/packages.txt that are missing. Works as root, and as a user with sudo.
set -eu
here=$(cd "$(dirname "$0")" && pwd)

packages=$(sed 's/#.*//' "$here/packages.txt")
missing=""
for package in $packages; do
  if ! dpkg-query -W -f '${Status}' "$package" 2>/dev/null | grep -q "ok installed"; then
    missing="$missing $package"
  fi
done
if [ -z "$missing" ]; then
  echo "packages: all installed" >&2
  exit 0
fi

if [ "$(id -u)" -eq 0 ]; then
  as_root=""
elif command -v sudo >/dev/null; then
  as_root="sudo"
else
  echo "packages: root or sudo is needed to install:$missing" >&2
  exit 1
fi
echo "packages: installing$missing" >&2
export DEBIAN_FRONTEND=noninteractive
$as_root apt-get -qq update
# shellcheck disable=SC2086  # A list of words.
$as_root apt-get -qq install -y --no-install-recommends $missing >/dev/null
echo "packages: done" >&2

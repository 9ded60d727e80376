#!/bin/sh
# From a fresh Debian 12 to shadowfit's main job: installs packages, builds, fetches the Sterngarten and runs the demo.
#
#   deploy/quickstart.sh [demo options]      as: deploy/quickstart.sh --frames 12 --out /tmp/demo
set -eu
root=$(cd "$(dirname "$0")/.." && pwd)
caller=$(pwd)

step() { echo "==> $*" >&2; }

step "1/4 packages"
"$root/deploy/install-packages.sh"

step "2/4 build (build/release; several minutes the first time)"
cd "$root"
cmake --preset release -DSHADOWFIT_TESTS=OFF >/dev/null
cmake --build --preset release --target shadowfit shadowfit-server

step "3/4 scene"
scene=sterngarten
"$root/deploy/fetch-sterngarten.sh" || {
  echo "the Sterngarten could not be fetched; the demo shows the built-in plaza instead" >&2
  scene=plaza
}

step "4/4 demo"
cd "$caller"
set -- --scene "$scene" "$@"
case " $* " in
  *" --out "* | *" --out="*) ;;
  *) set -- "$@" --out shadowfit-demo ;;
esac
exec "$root/build/release/bin/shadowfit" demo "$@"

#!/bin/sh
# Brings the Sterngarten model into the cache folder where shadowfit looks for the scene "sterngarten".
#
# The model is part of Debian's package stellarium-data: (c) 2012 Georg Zotti, ASTROSIM, VIAS/Vienna, CC BY-SA 4.0.
# The package is downloaded to a temporary folder and one folder of it unpacked; nothing is installed. Where the package
# is installed already, its files are copied instead. Works as root and as an ordinary user; does nothing the second time.
set -eu

scenes="${XDG_CACHE_HOME:-$HOME/.cache}/shadowfit/scenes"
target="$scenes/sterngarten"
folder=usr/share/stellarium/scenery3d/Sterngarten
model=Sterngarten_Wien_innerArea-optimized.obj

say() { echo "fetch-sterngarten: $*" >&2; }

if [ -f "$target/$model" ]; then
  say "already there: $target"
  exit 0
fi

mkdir -p "$scenes"
# Unpacked beside the target and moved in one step, so that an interrupted run leaves no half of a scene behind.
new=$(mktemp -d "$scenes/.sterngarten.XXXXXX")
work=$(mktemp -d)
trap 'rm -rf "$work" "$new"' EXIT
trap 'exit 1' HUP INT TERM

if [ -f "/$folder/$model" ]; then
  say "copying from the installed package: /$folder"
  cp -R "/$folder/." "$new/"
else
  # apt drops its privileges while it downloads and needs to reach the folder.
  chmod 755 "$work"
  download() { (cd "$work" && apt-get -qq download stellarium-data); }
  say "downloading the Debian package stellarium-data (235 MB; it will not be installed)"
  if ! download; then
    if [ "$(id -u)" -eq 0 ]; then
      say "refreshing apt's package lists first"
      apt-get -qq update
      download
    else
      say "failed; if apt's package lists are missing, run 'apt-get update' as root and then this script again"
      exit 1
    fi
  fi
  say "unpacking $folder"
  dpkg-deb --fsys-tarfile "$work"/stellarium-data_*.deb |
    tar -x -C "$new" --no-same-owner --strip-components=6 "./$folder"
fi

if [ ! -f "$new/$model" ]; then
  say "$model is not part of this version of stellarium-data"
  exit 1
fi
chmod -R u+rwX,go+rX "$new"
rm -rf "$target"
mv "$new" "$target"
say "done: $target"

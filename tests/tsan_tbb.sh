#!/bin/sh
# Builds oneTBB with the thread sanitizer, from Debian's source package, into a folder: tasks hand data to each
# other by TBB's atomics, and those of the packaged library the sanitizer does not see.
#
#   tests/tsan_tbb.sh FOLDER
set -eu
mkdir -p "$1"
folder=$(cd "$1" && pwd)
[ ! -f "$folder/lib/cmake/TBB/TBBConfig.cmake" ] || exit 0

# The machine's own Debian sources, asked for source packages, without a change to its configuration.
apt=$folder/apt
mkdir -p "$apt/parts" "$apt/lists/partial"
if [ -f /etc/apt/sources.list.d/debian.sources ]; then
  sed 's/^Types:.*/Types: deb-src/' /etc/apt/sources.list.d/debian.sources >"$apt/parts/source.sources"
else
  sed -n 's/^deb /deb-src /p' /etc/apt/sources.list >"$apt/parts/source.list"
fi
cd "$apt"
source_apt() {
  apt-get -qq -o Dir::Etc::sourcelist=/dev/null -o Dir::Etc::sourceparts="$apt/parts" -o Dir::State::lists="$apt/lists" "$@"
}
source_apt update
source_apt source --download-only onetbb
tar -xf onetbb_*.orig.tar.*

# GCC warns of fences, which the sanitizer does not follow.
cmake -S oneTBB-* -B build -G Ninja -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_CXX_FLAGS=-Wno-tsan \
  -DTBB_SANITIZE=thread -DTBB_TEST=OFF -DTBB_STRICT=OFF -DTBBMALLOC_BUILD=OFF -DCMAKE_INSTALL_PREFIX="$folder" >/dev/null
cmake --build build
cmake --install build >/dev/null
rm -rf "$apt"

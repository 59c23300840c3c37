#!/bin/sh
# Builds target/peers/embree against the system's Embree 3, or the one below EMBREE_ROOT.
set -eu
cd "$(dirname "$0")/../.."
mkdir -p target/peers
root=${EMBREE_ROOT:-/usr}
libraries=$root/lib/$(uname -m)-linux-gnu
${CXX:-c++} -O3 -march=native -std=c++17 -I"$root/include" benches/peers/embree.cpp -o target/peers/embree \
    -L"$libraries" -lembree3 -Wl,--disable-new-dtags,-rpath,"$libraries",-rpath-link,"$libraries"

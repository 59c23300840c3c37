#!/usr/bin/env bash
# Measures again, and makes the plots and tables of docs/accuracy.md: docs/accuracy/make.sh [OPTION OF bench]...
set -euo pipefail
cd "$(dirname "$0")/../.."
cargo build --release
out=out/accuracy
mkdir -p $out
target/release/relight bench graphs/physics.ron --scene tests/scenes/small --out $out "$@" > $out/tables.md
cp $out/*.svg $out/bench.csv docs/accuracy/
# A table goes between the line that names it and the line that ends it.
awk '
    NR == FNR { if (/^<!-- table: /) name = $0; else if (name && NF) table[name] = table[name] $0 "\n"; next }
    /^<!-- table: / { print; printf "%s", table[$0]; missing = missing || !($0 in table); inside = 1; next }
    /^<!-- end -->/ { inside = 0 }
    !inside
    END { exit missing }
' $out/tables.md docs/accuracy.md > $out/accuracy.md
cp $out/accuracy.md docs/accuracy.md

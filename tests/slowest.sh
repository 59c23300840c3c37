#!/usr/bin/env bash
# usage: tests/slowest.sh [ARGUMENT OF cargo test ..]
# Runs the tests but those of documentation, and lists the twenty that took longest. Seconds are those of the clock: tests run side by side, so that a test also waits
# for others.
set -euo pipefail
cd "$(dirname "$0")/.."
log=$(mktemp)
trap 'rm -f "$log"' EXIT
# Times per test are an unstable option of the test programs. Only they see RUSTC_BOOTSTRAP, as with it dependencies would be built anew.
host=$(rustc -vV | sed -n 's/^host: //p' | tr 'a-z-' 'A-Z_')
status=0
env "CARGO_TARGET_${host}_RUNNER=env RUSTC_BOOTSTRAP=1" cargo test --locked --release --lib --bins --tests "$@" -- -Z unstable-options --report-time \
    | tee "$log" || status=$?
printf '\nThe slowest twenty tests, in seconds:\n'
sed -nE 's/^test (.*) \.\.\. .* <([0-9.]+)s>$/\2 \1/p' "$log" | sort -rn | head -20 || true
exit $status

#!/bin/sh
# An LLVM library for Dr.Jit that does not name the processor it runs on: LLVM 19 makes no code for AMD's Zen 5. Usage: llvm.sh FOLDER [libLLVM.so.19.1]
set -eu
folder=$1
library=${2:-/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1}
mkdir -p "$folder"
cat > "$folder/shim.c" <<'C'
#include <string.h>
char *LLVMGetHostCPUName(void) { return strdup("haswell"); }
char *LLVMGetHostCPUFeatures(void) { return strdup("+avx,+avx2,+fma,+f16c,+bmi,+bmi2,+lzcnt,+popcnt,+sse4.2"); }
C
cc -shared -fPIC -o "$folder/libLLVM.so.19.1" "$folder/shim.c" -Wl,--no-as-needed -Wl,-rpath,"$(dirname "$library")" "$library"
echo "DRJIT_LIBLLVM_PATH=$folder/libLLVM.so.19.1"

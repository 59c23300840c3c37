"""The variant of Mitsuba that renders rooms: the environment variable MITSUBA_VARIANT, `llvm_ad_rgb` unless told. `cuda_ad_rgb` renders on a GPU, and denoises
there."""

import os

import mitsuba as mi

mi.set_variant(os.environ.get("MITSUBA_VARIANT", "llvm_ad_rgb"))
ON_GPU = mi.variant().startswith("cuda")

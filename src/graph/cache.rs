//! The memory cache.

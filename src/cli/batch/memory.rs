//! Memory of photos in flight, and processor time.

use std::path::Path;

/// A photo in flight takes this much at least, bytes: the program, its networks, its threads.
const BASE: u64 = 250 << 20;
/// And per pixel of the photo, at the peak of a run (docs/farm.md has the measurements).
const PER_PIXEL: u64 = 80;
/// Results that stay in memory for the next edit of the photo, bytes per pixel.
const RESULTS_PER_PIXEL: u64 = 400;
/// Pictures of a scene folder that are looked at.
const MOST_FILES: usize = 100;

/// Most memory that photos may take together, bytes: two thirds of what is free.
pub fn limit(gibibytes: Option<u32>) -> u64 {
    match gibibytes {
        Some(number) => u64::from(number) << 30,
        None => free().map_or(4 << 30, |free| free / 3 * 2),
    }
}

/// Memory that is free on this machine, and in the group of processes that a scheduler made.
fn free() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/meminfo").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("MemAvailable:"))?;
    let machine = 1024 * line.trim().strip_suffix("kB")?.trim().parse::<u64>().ok()?;
    let number = |name: &str| -> Option<u64> {
        let path = Path::new("/sys/fs/cgroup").join(name);
        std::fs::read_to_string(path).ok()?.trim().parse().ok()
    };
    let group = number("memory.max").zip(number("memory.current"));
    Some(group.map_or(machine, |(most, now)| machine.min(most.saturating_sub(now))))
}

/// The expected peak of a photo whose engine keeps at most `results` bytes in memory, bytes, from
/// the largest picture in its scene folder.
pub fn expected(scene: &Path, results: u64) -> u64 {
    let files = std::fs::read_dir(scene).into_iter().flatten().flatten().take(MOST_FILES);
    let pixels = files.filter_map(|file| {
        let (width, height) = image::image_dimensions(file.path()).ok()?;
        Some(u64::from(width) * u64::from(height))
    });
    let pixels = pixels.max().unwrap_or(0);
    BASE + PER_PIXEL * pixels + results.min(RESULTS_PER_PIXEL * pixels)
}

/// Processor time of this process and of its ended children, seconds.
#[cfg(unix)]
pub fn cpu_seconds() -> f64 {
    use nix::sys::resource::{UsageWho, getrusage};
    use nix::sys::time::TimeValLike;
    let of = |who| {
        let usage = getrusage(who).ok()?;
        Some((usage.user_time() + usage.system_time()).num_microseconds() as f64 * 1e-6)
    };
    [UsageWho::RUSAGE_SELF, UsageWho::RUSAGE_CHILDREN].into_iter().filter_map(of).sum()
}

#[cfg(not(unix))]
pub fn cpu_seconds() -> f64 {
    0.0
}

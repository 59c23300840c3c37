//! The numbers of a gain map in the form of Google's Ultra HDR image format 1.1: the map's XMP
//! packet, under `hdrgm`.

use glam::Vec3;

use super::gains::{BASE_IS_HDR, Gains, GainsOrReason, OUT_OF_RANGE};

/// The gains of a map by its XMP packet in the form of Ultra HDR, where it has that.
pub(super) fn gains(xmp: &str) -> Option<GainsOrReason> {
    if !xmp.contains("hdrgm:Version") {
        return None;
    }
    if xmp.contains("hdrgm:BaseRenditionIsHDR=\"True\"") {
        return Some(Err(BASE_IS_HDR));
    }
    let number = |name: &str, usual: f32| {
        numbers(xmp, &format!("hdrgm:{name}")).map(|found| found.unwrap_or(Vec3::splat(usual)))
    };
    let read = || {
        Some(Gains::Logarithmic {
            min: number("GainMapMin", 0.0)?,
            max: number("GainMapMax", f32::NAN)?,
            gamma: number("Gamma", 1.0)?,
            offset_base: number("OffsetSDR", 1.0 / 64.0)?,
            offset_alternate: number("OffsetHDR", 1.0 / 64.0)?,
            by_map_profile: false,
        })
    };
    Some(read().ok_or(OUT_OF_RANGE).and_then(Gains::checked))
}

/// The finite numbers of `name`, a name with its prefix, as an attribute or element for all
/// channels or as a list of three. The inner `None` is a name that is missing.
pub(super) fn numbers(xmp: &str, name: &str) -> Option<Option<Vec3>> {
    let number = |text: &str| text.trim().parse::<f32>().ok().filter(|n| n.is_finite());
    if let Some((_, rest)) = xmp.split_once(&format!("{name}=\"")) {
        return number(rest.split_once('"')?.0).map(|number| Some(Vec3::splat(number)));
    }
    let Some((_, rest)) = xmp.split_once(&format!("<{name}>")) else {
        return Some(None);
    };
    let (list, _) = rest.split_once(&format!("</{name}>"))?;
    let items = list.split("<rdf:li>").skip(1).take(3);
    let items: Option<Vec<f32>> = items.map(|item| number(item.split_once('<')?.0)).collect();
    let found = match items?[..] {
        [] => number(list).map(Vec3::splat)?,
        [all] => Vec3::splat(all),
        [r, g, b] => Vec3::new(r, g, b),
        _ => return None,
    };
    Some(Some(found))
}

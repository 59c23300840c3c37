//! The files of the page, inside the program.

/// Files of `page/` by their names.
macro_rules! files {
    ($( $name:literal ),* $(,)?) => {
        &[$( ($name, include_bytes!(concat!("page/", $name))) ),*]
    };
}

const FILES: &[(&str, &[u8])] = files![
    "index.html",
    "style.css",
    "icon.svg",
    "main.js",
    "model.js",
    "api.js",
    "ron.js",
    "edit.js",
    "view.js",
    "gl.js",
    "canvas2d.js",
    "lights.js",
    "sun.js",
    "tools.js",
    "brush.js",
    "overlays.js",
    "panels.js",
    "dom.js",
];

/// The module that the page shares with report.html.
const SHARED: (&str, &[u8]) = ("layers.js", include_bytes!("../../nodes/output/report/layers.js"));

/// The content type and the bytes of a file of the page.
pub fn find(name: &str) -> Option<(&'static str, &'static [u8])> {
    let (_, bytes) = FILES.iter().chain([&SHARED]).find(|(own, _)| *own == name)?;
    let kind = match name.rsplit_once('.')?.1 {
        "html" => "text/html; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "svg" => "image/svg+xml",
        "json" | "webmanifest" => "application/json",
        _ => "application/octet-stream",
    };
    Some((kind, bytes))
}

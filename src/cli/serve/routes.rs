//! The addresses of the server; docs/serve.md lists them.

use std::convert::Infallible;
use std::sync::Arc;

use axum::Router;
use axum::body::{Body, Bytes, to_bytes};
use axum::extract::{Path, Query, State};
use axum::http::{StatusCode, header};
use axum::middleware::from_fn_with_state;
use axum::response::sse::{self, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use futures_util::stream;
use relight::graph::{MAX_FILE_BYTES, escape, read};
use relight::nodes::edit::edit_lights::black_body;
use serde::Deserialize;
use serde_json::{Value, json};
use tokio::sync::broadcast::error::RecvError;

use super::auth::{Gate, Token, guard};
use super::edit::{Answer, MOST_TEXT, put};
use super::events::{Event, text};
use super::files::{self, MOST_MASK, Refusal};
use super::layers::manifest;
use super::scene::LONG_SIDE;
use super::state::Live;
use super::{assets, events};

/// Longest side of the layers of a page, in pixels.
const MOST_SIDE: u32 = 8192;
/// Color temperatures for the page, kelvin: steps of a slider.
const KELVINS: std::ops::RangeInclusive<u32> = 10..=400;

type Shared = State<Arc<Live>>;

/// All addresses, behind the gate.
pub fn router(live: Arc<Live>, token: Token, port: u16) -> Router {
    let gate = Arc::new(Gate::new(token, port));
    Router::new()
        .route("/", get(async || asset("index.html")))
        .route("/assets/{name}", get(async |Path(name): Path<String>| asset(&name)))
        .route("/api/state", get(state))
        .route("/api/edit", axum::routing::put(edit))
        .route("/api/layers", get(layers))
        .route("/api/blob/{digest}", get(blob))
        .route("/api/picture.png", get(async |live: Shared| result(live, "picture.png").await))
        .route("/api/report.json", get(async |live: Shared| result(live, "report.json").await))
        .route("/api/photo", get(photo))
        .route("/api/graph.svg", get(drawing))
        .route("/api/room", get(room))
        .route("/api/masks/{light}", get(mask).put(put_mask))
        .route("/api/snapshots", get(snapshots))
        .route("/api/snapshots/{name}", get(snapshot).put(put_snapshot).delete(delete_snapshot))
        .route("/api/events", get(follow))
        .with_state(live)
        .layer(from_fn_with_state(gate, guard))
}

fn json(status: StatusCode, data: &impl serde::Serialize) -> Response {
    (status, [(header::CONTENT_TYPE, "application/json")], text(data)).into_response()
}

fn refused((status, message): Refusal) -> Response {
    json(status, &json!({ "message": escape(&message) }))
}

fn file(kind: &'static str, bytes: impl Into<Body>) -> Response {
    ([(header::CONTENT_TYPE, kind)], bytes.into()).into_response()
}

/// The answer of work that may take a while. A panic in it is an error of this answer alone.
async fn blocking(work: impl FnOnce() -> Response + Send + 'static) -> Response {
    tokio::task::spawn_blocking(work).await.unwrap_or_else(|_| {
        refused((StatusCode::INTERNAL_SERVER_ERROR, "a bug in relight: it panicked".into()))
    })
}

/// The body of a request, at most `most` bytes.
async fn bytes(body: Body, most: usize) -> Result<Bytes, Response> {
    to_bytes(body, most).await.map_err(|_| {
        let message = format!("wanted at most {most} bytes");
        refused((StatusCode::PAYLOAD_TOO_LARGE, message))
    })
}

/// The body of a request, as text of an edit.
async fn body_text(body: Body) -> Result<String, Response> {
    String::from_utf8(bytes(body, MOST_TEXT).await?.into()).map_err(|_| {
        refused((StatusCode::BAD_REQUEST, "wanted UTF-8 text, got other bytes".into()))
    })
}

fn asset(name: &str) -> Response {
    match assets::find(name) {
        Some((kind, bytes)) => file(kind, bytes),
        None => missing("the page has no such file"),
    }
}

fn missing(message: &str) -> Response {
    refused((StatusCode::NOT_FOUND, message.into()))
}

async fn state(State(live): Shared) -> Response {
    let state = live.state();
    let path = |path: &std::path::Path| escape(&path.display().to_string()).into_owned();
    let temperatures = KELVINS.map(|kelvin| {
        let kelvin = 100 * kelvin;
        let [r, g, b] = black_body(kelvin as f32).to_array();
        json!([kelvin, r, g, b])
    });
    let data = json!({
        "relight": env!("CARGO_PKG_VERSION"),
        "scene": live.job.files.scene.as_deref().map(path),
        "graph": path(&live.job.graph), "out": path(&live.job.out),
        "edit": { "path": path(live.edit()), "text": state.text, "revision": state.revision },
        "draft": state.draft, "full": state.scene.full, "working": state.scene.working,
        "transfer": state.scene.transfer, "camera": state.scene.camera(),
        "lights": state.scene.lights, "masks": state.scene.masks().map(|(id, _)| id).collect::<Vec<&str>>(),
        "temperatures": temperatures.collect::<Vec<Value>>(),
        "run": state.run.now(),
    });
    json(StatusCode::OK, &data)
}

#[derive(Deserialize)]
struct EditQuery {
    base: u64,
    #[serde(default)]
    preview: u8,
}

async fn edit(State(live): Shared, Query(query): Query<EditQuery>, body: Body) -> Response {
    let text = match body_text(body).await {
        Ok(text) => text,
        Err(refused) => return refused,
    };
    blocking(move || match put(&live, text, query.base, query.preview > 0) {
        Answer::Accepted { revision } => json(StatusCode::OK, &json!({ "revision": revision })),
        Answer::Stale { revision, text } => {
            json(StatusCode::CONFLICT, &json!({ "revision": revision, "text": text }))
        }
        Answer::Faulty { diagnostics, text } => json(
            StatusCode::UNPROCESSABLE_ENTITY,
            &json!({ "diagnostics": diagnostics, "text": text }),
        ),
        Answer::Lost(fault) => refused((StatusCode::INTERNAL_SERVER_ERROR, fault.to_string())),
    })
    .await
}

#[derive(Deserialize)]
struct SizeQuery {
    long_side: Option<u32>,
}

impl SizeQuery {
    fn long_side(&self) -> u32 {
        self.long_side.unwrap_or(LONG_SIDE).clamp(1, MOST_SIDE)
    }
}

async fn layers(State(live): Shared, Query(query): Query<SizeQuery>) -> Response {
    let long_side = query.long_side();
    blocking(move || {
        let base = live.state().base.clone();
        match base {
            Some(base) => json(StatusCode::OK, &manifest(&live.packs, &base, long_side).json),
            None => missing("no layers are made so far: the event `layers` tells"),
        }
    })
    .await
}

async fn blob(State(live): Shared, Path(digest): Path<String>) -> Response {
    match live.blob(&digest) {
        Some(bytes) => {
            let forever = [(header::CACHE_CONTROL, "private, max-age=31536000, immutable")];
            (forever, file("application/octet-stream", bytes)).into_response()
        }
        None => missing("no layer of the newest ones has this digest: read /api/layers again"),
    }
}

/// A file of the results.
async fn result(State(live): Shared, name: &'static str) -> Response {
    let kind = if name.ends_with("png") { "image/png" } else { "application/json" };
    blocking(move || match read(&live.job.out.join(name), MAX_FILE_BYTES) {
        Ok(bytes) => file(kind, bytes),
        Err(_) => missing("no run has finished so far"),
    })
    .await
}

async fn photo(State(live): Shared, Query(query): Query<SizeQuery>) -> Response {
    let long_side = query.long_side();
    blocking(move || {
        let scene = live.state().scene.clone();
        file("image/png", scene.png(long_side))
    })
    .await
}

async fn drawing(State(live): Shared) -> Response {
    let drawing = live.state().drawing.clone();
    if drawing.is_empty() {
        return missing("no run has finished so far");
    }
    file("image/svg+xml", drawing)
}

async fn room(State(live): Shared) -> Response {
    let base = live.state().base.clone();
    json(StatusCode::OK, &base.as_ref().and_then(|base| base.room.as_ref()))
}

async fn mask(State(live): Shared, Path(light): Path<String>) -> Response {
    blocking(move || match files::read_light_mask(&live, &light) {
        Ok(bytes) => file("image/png", bytes),
        Err(why) => refused(why),
    })
    .await
}

async fn put_mask(State(live): Shared, Path(light): Path<String>, body: Body) -> Response {
    let bytes = match bytes(body, MOST_MASK).await {
        Ok(bytes) => bytes,
        Err(refused) => return refused,
    };
    blocking(move || done(files::write_light_mask(&live, &light, &bytes))).await
}

async fn snapshots(State(live): Shared) -> Response {
    blocking(move || json(StatusCode::OK, &files::snapshots(&live.job.out))).await
}

async fn snapshot(State(live): Shared, Path(name): Path<String>) -> Response {
    blocking(move || match files::read_snapshot(&live.job.out, &name) {
        Ok(bytes) => file("text/plain; charset=utf-8", bytes),
        Err(why) => refused(why),
    })
    .await
}

async fn put_snapshot(State(live): Shared, Path(name): Path<String>, body: Body) -> Response {
    let text = match body_text(body).await {
        Ok(text) => text,
        Err(refused) => return refused,
    };
    blocking(move || done(files::write_snapshot(&live.job.out, &name, &text))).await
}

async fn delete_snapshot(State(live): Shared, Path(name): Path<String>) -> Response {
    blocking(move || done(files::remove_snapshot(&live.job.out, &name))).await
}

fn done(done: Result<(), Refusal>) -> Response {
    done.map_or_else(refused, |()| json(StatusCode::OK, &json!({})))
}

/// The events from now on, after the state of the run.
async fn follow(State(live): Shared) -> Response {
    let receiver = live.events();
    let first = Event::new("state", &live.state().run.now());
    let events =
        stream::unfold((Some(first), receiver, live), async |(first, mut receiver, live)| {
            let event = match first {
                Some(event) => event,
                None => match receiver.recv().await {
                    Ok(event) => event,
                    // A page that was too slow learns where things stand.
                    Err(RecvError::Lagged(_)) => Event::new("state", &live.state().run.now()),
                    Err(RecvError::Closed) => return None,
                },
            };
            let events::Event { name, data } = event;
            let sent = sse::Event::default().event(name).data(data);
            Some((Ok::<_, Infallible>(sent), (None, receiver, live)))
        });
    Sse::new(events).keep_alive(KeepAlive::default()).into_response()
}

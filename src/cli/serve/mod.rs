//! `relight serve`: a page in the browser that edits one scene and shows it at once. The feature
//! `serve` turns it on.
//!
//! The text of the edit file is the state; the server computes pictures of it, on one engine that
//! stays warm, and nothing of a page is lost when it closes. Handlers change the state
//! (`state.rs`), the worker (`worker.rs`) computes what it asks for, and events tell the pages.

mod args;
mod assets;
mod auth;
mod edit;
mod events;
mod files;
mod layers;
mod lock;
mod progress;
mod routes;
mod scene;
mod state;
mod worker;

use std::net::{Ipv4Addr, SocketAddr};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use relight::graph::Diagnostic;

pub use args::ServeArgs;

use super::engine::Host;
use super::exit::{CliError, Exit};
use super::messages::message;
use super::results::engine_options;
use super::write;
use auth::Token;
use lock::Lock;
use state::Live;

/// Interval between looks whether Ctrl-C was pressed.
const LOOK: Duration = Duration::from_millis(50);

/// Runs `relight serve`.
///
/// # Errors
/// Arguments, graph or scene that cannot be used; an edit with faults is shown in the page.
pub fn serve(args: &ServeArgs) -> Result<Exit, CliError> {
    let job = args.job();
    let host = Host::new(engine_options(&job)?)?;
    let cannot =
        |e: std::io::Error| Diagnostic::file(&job.out, format!("the folder cannot be made: {e}"));
    std::fs::create_dir_all(&job.out).map_err(cannot)?;
    let lock = Lock::take(&job.out)?;
    let scene = scene::Scene::read(&job, &host.engine)?;

    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build();
    let runtime = runtime.map_err(|e| network(format!("the server cannot be started: {e}")))?;
    let address = SocketAddr::from((Ipv4Addr::LOCALHOST, args.port));
    let listener = runtime.block_on(tokio::net::TcpListener::bind(address)).map_err(|e| {
        network(format!("{address} cannot be used: {e}"))
            .help("name another port with --port, or leave it out for a free one")
    })?;
    let port = listener.local_addr().map_err(|e| network(e.to_string()))?.port();
    lock.note(port);
    let token = Token::new().map_err(|e| network(format!("no token can be made: {e}")))?;
    let link = format!("http://127.0.0.1:{port}/?token={}", token.text());
    let live = Arc::new(Live::new(job, scene, host.cancel.clone()));

    edit::begin(&live);
    let (worker, watcher) = (live.clone(), live.clone());
    let engine = host.engine;
    let worker = std::thread::spawn(move || worker::work(&worker, &engine));
    let watcher = std::thread::spawn(move || edit::watch(&watcher));
    message!(
        "serving {}; Ctrl-C ends",
        live.job.files.scene.as_deref().unwrap_or(Path::new("")).display()
    );
    write::print(&format!("{link}\n"))?;
    let ended = host.cancel.clone();
    let served = runtime.block_on(async {
        let end = async {
            while !ended.is_cancelled() {
                tokio::time::sleep(LOOK).await;
            }
        };
        let serving = axum::serve(listener, routes::router(live.clone(), token, port));
        // Streams of events never end by themselves, so that the end does not wait for answers.
        tokio::select! {
            served = async { serving.await } => served,
            () = end => Ok(()),
        }
    });
    host.cancel.cancel();
    live.end();
    runtime.shutdown_background();
    for thread in [worker, watcher] {
        let _ = thread.join();
    }
    served.map_err(|e| network(e.to_string()))?;
    Ok(Exit::Interrupted)
}

fn network(message: String) -> Diagnostic {
    Diagnostic::file("".as_ref(), message)
}

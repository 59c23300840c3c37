//! The cache in an object store: `--cache-store URL`. The feature `store` turns it on.

#[cfg(feature = "store")]
mod address;
#[cfg(feature = "store")]
mod client;
#[cfg(feature = "store")]
mod profile;
#[cfg(feature = "store")]
mod secrets;
mod traffic;

#[cfg(feature = "store")]
pub use address::check;
#[cfg(feature = "store")]
pub use client::Client;
pub use traffic::Traffic;

/// The client of a program that has none.
#[cfg(not(feature = "store"))]
#[derive(Debug)]
pub enum Client {}

#[cfg(not(feature = "store"))]
impl Client {
    pub fn traffic(&self) -> Traffic {
        match *self {}
    }

    pub fn flush(&self) -> u64 {
        match *self {}
    }
}

#[cfg(not(feature = "store"))]
impl relight::graph::BlobStore for Client {
    fn get(&self, _: &[(String, u64)]) -> Vec<Option<Vec<u8>>> {
        match *self {}
    }

    fn put(&self, _: Vec<(String, Vec<u8>)>, _: (String, Vec<u8>)) {
        match *self {}
    }

    fn take_warnings(&self) -> Vec<String> {
        match *self {}
    }
}

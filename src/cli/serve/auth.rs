//! Who may use the server: the person who started it, in a browser on the same machine.
//!
//! Any page that the same browser shows can send requests to 127.0.0.1, and a name of its own may
//! resolve to it. So a request needs the token, which is in the printed address and then in a
//! cookie that other sites cannot send, and its `Host` and `Origin` must be those of the server.

use std::sync::Arc;

use axum::extract::{Request, State};
use axum::http::header::{self, HeaderMap, HeaderName, HeaderValue};
use axum::http::{StatusCode, Uri};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

/// Bytes of a token: 128 bits.
const BYTES: usize = 16;

/// The secret of one server.
pub struct Token(String);

impl Token {
    /// Makes a token.
    ///
    /// # Errors
    /// The system gives no random numbers.
    pub fn new() -> Result<Token, getrandom::Error> {
        let mut bytes = [0; BYTES];
        getrandom::fill(&mut bytes)?;
        Ok(Token(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    pub fn text(&self) -> &str {
        &self.0
    }

    /// Whether `given` is the token. The time that this takes does not depend on the digits:
    /// digests are compared, and their equality is of constant time.
    fn is(&self, given: &str) -> bool {
        blake3::hash(given.as_bytes()) == blake3::hash(self.0.as_bytes())
    }
}

/// The conditions of a request.
pub struct Gate {
    token: Token,
    /// The names of the server, `127.0.0.1:PORT` and so on.
    hosts: [String; 3],
    cookie: String,
}

impl Gate {
    pub fn new(token: Token, port: u16) -> Gate {
        let hosts = ["127.0.0.1", "localhost", "[::1]"].map(|name| format!("{name}:{port}"));
        // Browsers keep cookies by host alone, and there may be a server on another port.
        Gate { token, hosts, cookie: format!("relight_{port}") }
    }

    /// The answer to a request that goes no further: one that is refused, or that opens the printed
    /// address.
    fn answer(&self, uri: &Uri, headers: &HeaderMap) -> Option<Response> {
        let refused =
            |status: StatusCode, why: &str| Some((status, why.to_owned()).into_response());
        let mut hosts = headers.get_all(header::HOST).iter();
        let host =
            hosts.next().and_then(|host| host.to_str().ok()).filter(|_| hosts.next().is_none());
        let is_own = |host: &str| self.hosts.iter().any(|own| own == host);
        if !host.is_some_and(is_own) || uri.authority().is_some_and(|host| !is_own(host.as_str())) {
            return refused(StatusCode::MISDIRECTED_REQUEST, "this server has another name\n");
        }
        let is_own_origin = |origin: &HeaderValue| {
            origin
                .to_str()
                .ok()
                .and_then(|origin| origin.strip_prefix("http://"))
                .is_some_and(is_own)
        };
        if !headers.get_all(header::ORIGIN).iter().all(is_own_origin) {
            return refused(StatusCode::FORBIDDEN, "requests of other sites are refused\n");
        }
        let named = uri
            .query()
            .filter(|_| uri.path() == "/")
            .and_then(|query| query.split('&').find_map(|part| part.strip_prefix("token=")));
        if let Some(token) = named {
            if !self.token.is(token) {
                return refused(StatusCode::UNAUTHORIZED, ASK);
            }
            let cookie =
                format!("{}={}; HttpOnly; SameSite=Strict; Path=/", self.cookie, self.token.text());
            let to_page = [(header::LOCATION, "/".to_owned()), (header::SET_COOKIE, cookie)];
            return Some((StatusCode::SEE_OTHER, to_page).into_response());
        }
        let cookies = headers.get_all(header::COOKIE).iter().filter_map(|all| all.to_str().ok());
        let mut of_cookies = cookies
            .flat_map(|all| all.split(';'))
            .filter_map(|cookie| cookie.trim().split_once('='))
            .filter(|(name, _)| *name == self.cookie);
        let bearer = headers.get(header::AUTHORIZATION).and_then(|value| value.to_str().ok());
        let bearer = bearer.and_then(|value| value.strip_prefix("Bearer "));
        if bearer.is_some_and(|token| self.token.is(token))
            || of_cookies.any(|(_, token)| self.token.is(token))
        {
            return None;
        }
        refused(StatusCode::UNAUTHORIZED, ASK)
    }
}

const ASK: &str = "open the address that `relight serve` printed, with its token\n";

/// Headers of every answer. A page may load from the server alone, and no other site may frame it.
const HEADERS: [(HeaderName, &str); 6] = [
    (
        header::CONTENT_SECURITY_POLICY,
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; \
         connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    ),
    (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
    (header::X_FRAME_OPTIONS, "DENY"),
    (header::REFERRER_POLICY, "no-referrer"),
    (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
];

/// Lets requests of the person pass, and gives all answers their headers.
pub async fn guard(State(gate): State<Arc<Gate>>, request: Request, next: Next) -> Response {
    let mut response = match gate.answer(request.uri(), request.headers()) {
        Some(answer) => answer,
        None => next.run(request).await,
    };
    let headers = response.headers_mut();
    for (name, value) in HEADERS {
        headers.insert(name, HeaderValue::from_static(value));
    }
    headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    response
}

#[cfg(test)]
mod tests {
    use super::*;

    fn status(uri: &str, headers: &[(&str, &str)]) -> u16 {
        let gate = Gate::new(Token("00ff".into()), 80);
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            let name = HeaderName::from_bytes(name.as_bytes()).expect("a name");
            map.append(name, HeaderValue::from_str(value).expect("a value"));
        }
        let uri = uri.parse().expect("an address");
        gate.answer(&uri, &map).map_or(200, |response| response.status().as_u16())
    }

    #[test]
    fn a_request_needs_host_origin_and_token() {
        let (host, token) = (("host", "127.0.0.1:80"), ("authorization", "Bearer 00ff"));
        let cookie = ("cookie", "relight_79=no; relight_80=00ff");
        assert_eq!(status("/", &[host, token]), 200);
        assert_eq!(
            status("/", &[("host", "localhost:80"), cookie, ("origin", "http://[::1]:80")]),
            200
        );
        assert_eq!(status("/", &[host, ("cookie", "relight_80=00fe; other=00ff")]), 401);
        for other in ["evil.example:80", "127.0.0.1", "127.0.0.1:81", "127.0.0.1:80.evil.example"] {
            assert_eq!(status("/", &[("host", other), token]), 421, "{other}");
        }
        assert_eq!(status("/", &[token]), 421);
        assert_eq!(status("/", &[host, ("host", "evil.example"), token]), 421);
        assert_eq!(status("http://evil.example/", &[host, token]), 421);
        for other in [
            "null",
            "http://evil.example",
            "https://127.0.0.1:80",
            "http://127.0.0.1:80.evil.example",
        ] {
            assert_eq!(status("/", &[host, token, ("origin", other)]), 403, "{other}");
        }
        assert_eq!(status("/", &[host]), 401);
        assert_eq!(status("/", &[host, ("authorization", "Bearer ")]), 401);
        assert_eq!(status("/?token=00ff", &[host]), 303);
        assert_eq!(status("/?token=00fe", &[host, token]), 401);
        assert_eq!(
            status("/api/state?token=00ff", &[host]),
            401,
            "the address opens the page alone"
        );
    }

    #[test]
    fn tokens_have_128_bits_and_differ() {
        let [a, b] = [(); 2].map(|()| Token::new().expect("there are random numbers"));
        assert_eq!(a.text().len(), 32);
        assert_ne!(a.text(), b.text());
    }
}

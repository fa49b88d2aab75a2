//! `abbe serve`: pages of a history for a browser on the same computer. It only reads.
//!
//! Requests have bounds: on their size, on the time that they take, on their number at a time. Nothing in a request names a file.

mod answers;
mod request;

use std::convert::Infallible;
use std::io::Write as _;
use std::net::SocketAddr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

use abbe_core::{Error, Registry, Result};
use clap::Args;
use http_body_util::Full;
use hyper::body::{Bytes, Incoming};
use hyper::header::{ALLOW, CONTENT_TYPE, HeaderValue};
use hyper::server::conn::http1;
use hyper::service::service_fn;
use hyper::{Method, Request, Response, StatusCode};
use hyper_util::rt::{TokioIo, TokioTimer};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;

use crate::history::read;
use crate::terminal::tell;
use answers::{Answer, Pages};

/// Bytes of a request's head at most.
const LARGEST_HEAD: usize = 16 << 10;

/// Headers of a request at most.
const MOST_HEADERS: usize = 64;

/// How long the head of a request may take.
const SLOWEST_HEAD: Duration = Duration::from_secs(5);

/// How long a connection may stay, whatever is asked on it.
const LONGEST_CONNECTION: Duration = Duration::from_secs(60);

/// Connections at a time; further ones are closed at once.
const CONNECTIONS: usize = 32;

/// Pages that are made at a time; further ones wait.
const PAGES: usize = 2;

/// How long a page may take, with the time that it waits.
const SLOWEST_PAGE: Duration = Duration::from_secs(30);

/// A history to show.
#[derive(Args)]
pub struct Serve {
    /// The history.
    history: PathBuf,
    /// Where to listen: an address of this computer for itself (loopback) and a port; port 0 takes a free one.
    #[arg(long, value_name = "ADDRESS:PORT", default_value = "127.0.0.1:8321")]
    listen: String,
}

impl Serve {
    /// Listens until it is interrupted.
    pub fn run(self, registry: Registry) -> Result<(String, u8)> {
        let address = loopback(&self.listen)?;
        // What cannot be read now will not be read later.
        read(&self.history)?;
        let pages = Arc::new(Pages { history: self.history, registry });
        let runtime = tokio::runtime::Builder::new_current_thread().enable_all().max_blocking_threads(PAGES).build();
        let runtime = runtime.map_err(|error| Error::data(format!("the server cannot start: {error}")))?;
        runtime.block_on(listen(address, pages))?;
        Ok((String::new(), 0))
    }
}

/// The address to listen on. Pages have no passwords and no encryption: other computers come through a proxy that has.
fn loopback(text: &str) -> Result<SocketAddr> {
    let address: SocketAddr = text.replace("localhost:", "127.0.0.1:").parse().map_err(|_| {
        Error::usage(format!("--listen: `{text}` is no address with a port")).help("one as 127.0.0.1:8321 was expected")
    })?;
    if address.ip().is_loopback() {
        return Ok(address);
    }
    Err(Error::usage(format!(
        "--listen: {text} can be reached from other computers, and these pages ask nobody who he is"
    ))
    .help("listen on 127.0.0.1:8321, and let a proxy of the plant with passwords and encryption lead there"))
}

async fn listen(address: SocketAddr, pages: Arc<Pages>) -> Result<()> {
    let cannot = |error: std::io::Error| {
        Error::usage(format!("--listen: {address} cannot be used: {error}"))
            .help("name another port; 0 takes a free one")
    };
    let listener = TcpListener::bind(address).await.map_err(cannot)?;
    let address = listener.local_addr().map_err(cannot)?;
    let mut out = std::io::stdout();
    writeln!(out, "http://{address}/ shows the history; Ctrl-C ends it")
        .and_then(|()| out.flush())
        .map_err(|error| Error::data(format!("the output cannot be written: {}", abbe_files::why(&error))))?;
    let (connections, making) = (Arc::new(Semaphore::new(CONNECTIONS)), Arc::new(Semaphore::new(PAGES)));
    loop {
        // Without a free place, or a free handle of a file, a client is turned away or waits; the server goes on.
        let Ok((stream, _)) = listener.accept().await else {
            tokio::time::sleep(Duration::from_millis(100)).await;
            continue;
        };
        let Ok(place) = Arc::clone(&connections).try_acquire_owned() else { continue };
        let (pages, making) = (Arc::clone(&pages), Arc::clone(&making));
        tokio::spawn(async move {
            let _ = timeout(LONGEST_CONNECTION, serve(stream, pages, making)).await;
            drop(place);
        });
    }
}

async fn serve(stream: TcpStream, pages: Arc<Pages>, making: Arc<Semaphore>) {
    let service = service_fn(move |request: Request<Incoming>| {
        let (pages, making) = (Arc::clone(&pages), Arc::clone(&making));
        async move { Ok::<_, Infallible>(respond(&request, pages, making).await) }
    });
    let mut server = http1::Builder::new();
    server.timer(TokioTimer::new()).header_read_timeout(SLOWEST_HEAD).max_buf_size(LARGEST_HEAD);
    server.max_headers(MOST_HEADERS).half_close(false);
    // A client that breaks the protocol, or leaves, is none of our errors.
    let _ = server.serve_connection(TokioIo::new(stream), service).await;
}

/// The response to a request.
async fn respond(request: &Request<Incoming>, pages: Arc<Pages>, making: Arc<Semaphore>) -> Response<Full<Bytes>> {
    let asked = match request::check(request) {
        Ok(asked) => asked,
        Err(refusal) => return response(request.method(), refusal),
    };
    let work = async {
        let place = making.acquire_owned().await.ok()?;
        tokio::task::spawn_blocking(move || {
            let answer = pages.answer(&asked);
            drop(place);
            answer
        })
        .await
        .ok()
    };
    let answer = match timeout(SLOWEST_PAGE, work).await {
        Ok(Some(answer)) => answer,
        Ok(None) => Answer::refusal(StatusCode::INTERNAL_SERVER_ERROR, "The page could not be made."),
        Err(_) => Answer::refusal(StatusCode::SERVICE_UNAVAILABLE, "The page takes too long. Try again later."),
    };
    if let Some(said) = &answer.for_operator {
        tell(&format!("{said}\n"));
    }
    response(request.method(), answer)
}

/// An answer with the headers that all have.
fn response(method: &Method, answer: Answer) -> Response<Full<Bytes>> {
    let length = answer.content.len();
    let body = if method == Method::HEAD { Bytes::new() } else { Bytes::from(answer.content) };
    let mut response = Response::new(Full::new(body));
    *response.status_mut() = answer.status;
    let headers = response.headers_mut();
    headers.insert(CONTENT_TYPE, HeaderValue::from_static(answer.kind));
    headers.insert("content-length", HeaderValue::from(length));
    for (name, value) in [
        ("x-content-type-options", "nosniff"),
        ("x-frame-options", "DENY"),
        ("referrer-policy", "no-referrer"),
        ("cross-origin-resource-policy", "same-origin"),
        ("cross-origin-opener-policy", "same-origin"),
        ("content-security-policy", "frame-ancestors 'none'"),
        ("cache-control", "no-store"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    if answer.status == StatusCode::METHOD_NOT_ALLOWED {
        headers.insert(ALLOW, HeaderValue::from_static("GET, HEAD"));
    }
    if answer.ends {
        headers.insert("connection", HeaderValue::from_static("close"));
    }
    response
}

#[cfg(test)]
mod tests {
    use super::loopback;

    #[test]
    fn only_this_computer_is_listened_to() {
        for text in ["127.0.0.1:8321", "localhost:0", "[::1]:80", "127.9.9.9:1"] {
            assert!(loopback(text).is_ok(), "{text}");
        }
        for text in ["0.0.0.0:8321", "[::]:8321", "192.168.1.2:80", "[::ffff:10.0.0.1]:80", "8321", "plant:80", ""] {
            assert!(loopback(text).is_err(), "{text}");
        }
        assert!(loopback("0.0.0.0:8321").unwrap_err().help.unwrap().contains("proxy"));
    }
}

//! What a request asks for; what is refused before anything is read.

use std::net::IpAddr;

use hyper::body::{Body, Incoming};
use hyper::header::HOST;
use hyper::{HeaderMap, Method, Request, StatusCode};

use super::answers::Answer;

/// Bytes of a path with its query at most.
const LONGEST_ADDRESS: usize = 4096;

/// A page that is asked for.
#[derive(Debug, PartialEq, Eq)]
pub struct Asked {
    /// The parts of its path, decoded.
    pub path: Vec<String>,
    /// Names and values after `?`, decoded.
    pub query: Vec<(String, String)>,
}

impl Asked {
    /// The value of a name after `?`.
    pub fn value(&self, name: &str) -> Option<&str> {
        self.query.iter().find(|(own, _)| own == name).map(|(_, value)| value.as_str())
    }
}

/// The page that a request asks for, or why it gets none.
pub fn check(request: &Request<Incoming>) -> Result<Asked, Answer> {
    if !matches!(*request.method(), Method::GET | Method::HEAD) {
        let refusal = Answer::refusal(StatusCode::METHOD_NOT_ALLOWED, "These pages can only be read (GET, HEAD).");
        return Err(Answer { ends: true, ..refusal });
    }
    if !request.body().is_end_stream() {
        let refusal = Answer::refusal(StatusCode::PAYLOAD_TOO_LARGE, "A request for a page has no content.");
        return Err(Answer { ends: true, ..refusal });
    }
    if !is_for_this_computer(request.headers()) {
        let text = "These pages have the address of this computer: http://127.0.0.1 with the port. A proxy has to ask for them \
                    under this name.";
        return Err(Answer::refusal(StatusCode::FORBIDDEN, text));
    }
    let uri = request.uri();
    asked(uri.path(), uri.query().unwrap_or_default())
}

/// Whether the request names this computer. A page from elsewhere, whose name was made to mean this computer, names itself.
fn is_for_this_computer(headers: &HeaderMap) -> bool {
    let mut hosts = headers.get_all(HOST).iter();
    let (Some(Ok(host)), None) = (hosts.next().map(|host| host.to_str()), hosts.next()) else { return false };
    let name = match host.rsplit_once(':') {
        Some((name, port)) if !port.is_empty() && port.bytes().all(|byte| byte.is_ascii_digit()) => name,
        _ => host,
    };
    let address = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
    name.eq_ignore_ascii_case("localhost") || address.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

fn asked(path: &str, query: &str) -> Result<Asked, Answer> {
    let wrong = || Answer::refusal(StatusCode::BAD_REQUEST, "This address cannot be read.");
    if path.len() + query.len() > LONGEST_ADDRESS {
        return Err(Answer::refusal(StatusCode::URI_TOO_LONG, "This address is too long."));
    }
    let parts = path.strip_prefix('/').ok_or_else(wrong)?;
    let parts: Option<Vec<String>> = match parts.is_empty() {
        true => Some(Vec::new()),
        false => parts.split('/').map(|part| decoded(part, false)).collect(),
    };
    let pairs = query.split('&').filter(|pair| !pair.is_empty()).map(|pair| {
        let (name, value) = pair.split_once('=').unwrap_or((pair, ""));
        Some((decoded(name, true)?, decoded(value, true)?))
    });
    let query = pairs.collect::<Option<Vec<_>>>().ok_or_else(wrong)?;
    Ok(Asked { path: parts.ok_or_else(wrong)?, query })
}

/// Text of an address; none if it is no UTF-8 or has a wrong `%`.
fn decoded(text: &str, plus_is_blank: bool) -> Option<String> {
    let mut bytes = Vec::with_capacity(text.len());
    let mut given = text.bytes();
    while let Some(byte) = given.next() {
        bytes.push(match byte {
            b'%' => {
                let digit = |byte: u8| char::from(byte).to_digit(16);
                let (high, low) = (digit(given.next()?)?, digit(given.next()?)?);
                u8::try_from(16 * high + low).ok()?
            }
            b'+' if plus_is_blank => b' ',
            other => other,
        });
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_decoded_once() {
        let found = asked("/entry/7/a%2Fb", "name=mill+7%2B&x=%2541").unwrap();
        assert_eq!(found.path, ["entry", "7", "a/b"]);
        assert_eq!((found.value("name"), found.value("x"), found.value("y")), (Some("mill 7+"), Some("%41"), None));
        assert!(asked("/", "").unwrap().path.is_empty());
        for (path, query) in [("/%", ""), ("/%zz", ""), ("/", "name=%ff"), ("x", ""), (&"/a".repeat(4000), "")] {
            assert!(asked(path, query).is_err(), "{path}");
        }
    }

    #[test]
    fn a_name_that_was_made_to_mean_this_computer_is_refused() {
        let of = |host: &str| {
            let mut headers = HeaderMap::new();
            headers.insert(HOST, host.parse().unwrap());
            is_for_this_computer(&headers)
        };
        for host in ["127.0.0.1:8321", "localhost", "LOCALHOST:1", "[::1]:8321", "127.0.0.1"] {
            assert!(of(host), "{host}");
        }
        for host in ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example:8321", "10.0.0.1", ""] {
            assert!(!of(host), "{host}");
        }
        assert!(!is_for_this_computer(&HeaderMap::new()));
    }
}

//! Access to the page: requests with the whole address, from this machine, made by a page of this server.
//!
//! The server listens on the loopback interface only, which every user of the machine and every page in the
//! user's browser can reach. So the address contains a random token, and the origin that a browser states
//! must be the host that it asks: a page of another origin that has guessed the port, or has pointed a name of its own
//! at this machine (DNS rebinding), is refused. The host must be a name of the loopback interface. Its port is that of the browser's
//! side, which is another one if the port of this server is forwarded (`ssh -L 9000:localhost:PORT`).

use hyper::header::{AUTHORIZATION, HOST, HeaderMap, ORIGIN};
use hyper::{Method, StatusCode};
use rustix::rand::{GetRandomFlags, getrandom};
use std::fmt::Write;
use std::io;

/// A secret of 128 bits in the address.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Token(String);

impl Token {
    /// Returns a new token from the system's source of randomness.
    ///
    /// # Errors
    /// If that source cannot be read.
    pub fn random() -> io::Result<Token> {
        let mut bytes = [0u8; 16];
        let n = getrandom(&mut bytes, GetRandomFlags::empty())?;
        if n != bytes.len() {
            return Err(io::Error::other("the system gave too few random bytes"));
        }
        let mut text = String::with_capacity(32);
        for byte in bytes {
            // Writing to a string cannot fail.
            let _ = write!(text, "{byte:02x}");
        }
        Ok(Token(text))
    }
    /// Returns the token as it stands in the address.
    pub fn text(&self) -> &str {
        &self.0
    }
    /// Returns whether the guess is the token. The time taken does not depend on how much of it is right.
    pub fn is(&self, guess: &str) -> bool {
        let differ = self.0.bytes().zip(guess.bytes()).fold(0, |d, (a, b)| d | (a ^ b));
        guess.len() == self.0.len() && differ == 0
    }
}

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Refusal {
    /// Its method is neither GET nor HEAD.
    Method,
    /// It is for another host than this one.
    Host,
    /// It comes from a page of another server.
    Origin,
    /// Its token is wrong or missing.
    Token,
    /// It would change something, and does not say that it comes from a page of this server, or lacks the secret.
    Secret,
}

impl Refusal {
    /// Returns the status and the text of the response.
    pub fn answer(self) -> (StatusCode, &'static str) {
        match self {
            Refusal::Method => (StatusCode::METHOD_NOT_ALLOWED, "this page can only be read (GET or HEAD)\n"),
            Refusal::Host => (
                StatusCode::FORBIDDEN,
                "this server is reached as localhost or 127.0.0.1 only; from another machine forward its port, \
                 for example with ssh -L 9000:localhost:PORT, and open http://localhost:9000/ with the rest of the address\n",
            ),
            Refusal::Origin => (StatusCode::FORBIDDEN, "pages of other servers may not read this one\n"),
            Refusal::Token => {
                (StatusCode::NOT_FOUND, "not found; open the whole address that metamorph has printed\n")
            }
            Refusal::Secret => {
                (StatusCode::FORBIDDEN, "commands need the second address that metamorph has printed\n")
            }
        }
    }
}

/// The access check of a server.
#[derive(Clone, Debug)]
pub struct AccessCheck {
    token: Token,
    port: u16,
}

impl AccessCheck {
    /// Creates the check of the server on this port.
    pub fn new(token: Token, port: u16) -> AccessCheck {
        AccessCheck { token, port }
    }

    /// Returns the address of the page.
    pub fn address(&self) -> String {
        format!("http://127.0.0.1:{}/{}/", self.port, self.token.text())
    }

    /// Checks a request, and returns the rest of its path, after the token.
    ///
    /// # Errors
    /// Returns the reason if the request is refused.
    pub fn admit<'a>(&self, method: &Method, headers: &HeaderMap, path: &'a str) -> Result<&'a str, Refusal> {
        if !matches!(*method, Method::GET | Method::HEAD) {
            return Err(Refusal::Method);
        }
        self.admit_any(headers, path)
    }

    /// Like [`AccessCheck::admit`] for a page that other pages of this machine may show in a frame: of a request for the
    /// document of a frame, it does not matter which page has the frame. What the document loads is as for any page.
    ///
    /// # Errors
    /// Returns the reason if the request is refused.
    pub fn admit_frame<'a>(
        &self,
        method: &Method,
        headers: &HeaderMap,
        path: &'a str,
    ) -> Result<&'a str, Refusal> {
        let states = |name: &str, value: &str| headers.get(name).is_some_and(|stated| stated == value);
        let mut stated = headers.clone();
        if states("sec-fetch-dest", "iframe") && states("sec-fetch-mode", "navigate") {
            stated.remove("sec-fetch-site");
        }
        self.admit(method, &stated, path)
    }

    /// Checks a request that changes something, and returns the rest of its path, after the token.
    ///
    /// # Errors
    /// Returns the reason if the request is refused.
    pub fn admit_post<'a>(
        &self,
        secret: &Token,
        headers: &HeaderMap,
        path: &'a str,
    ) -> Result<&'a str, Refusal> {
        let rest = self.admit_any(headers, path)?;
        // A browser states the origin of every such request. `none` is an address that was typed.
        let sites: Vec<_> = headers.get_all("sec-fetch-site").iter().collect();
        let is_stated = headers.get_all(ORIGIN).iter().count() == 1;
        let is_ours = is_stated && sites.iter().all(|site| *site == "same-origin");
        if is_ours && holds_secret(secret, headers) { Ok(rest) } else { Err(Refusal::Secret) }
    }

    /// Checks what all requests must state, and returns the rest of the path.
    fn admit_any<'a>(&self, headers: &HeaderMap, path: &'a str) -> Result<&'a str, Refusal> {
        let mut hosts = headers.get_all(HOST).iter();
        let host = hosts.next().and_then(|h| h.to_str().ok());
        let Some(host) = host.filter(|host| hosts.next().is_none() && is_loopback(host)) else {
            return Err(Refusal::Host);
        };
        let is_ours = |origin: &str| origin.strip_prefix("http://") == Some(host);
        if headers.get_all(ORIGIN).iter().any(|o| !o.to_str().is_ok_and(is_ours)) {
            return Err(Refusal::Origin);
        }
        // Browsers state here where a request comes from; `none` is an address that was typed or opened.
        let site = headers.get_all("sec-fetch-site").iter();
        if site.into_iter().any(|s| !matches!(s.as_bytes(), b"same-origin" | b"none")) {
            return Err(Refusal::Origin);
        }
        let (token, rest) = path.strip_prefix('/').and_then(|p| p.split_once('/')).ok_or(Refusal::Token)?;
        if self.token.is(token) { Ok(rest) } else { Err(Refusal::Token) }
    }
}

/// Returns true if a host with its port is a name of the loopback interface.
fn is_loopback(host: &str) -> bool {
    host.rsplit_once(':').is_some_and(|(name, port)| {
        matches!(name, "localhost" | "127.0.0.1" | "[::1]") && port.parse::<u16>().is_ok()
    })
}

/// Returns whether the headers of a request hold the secret.
fn holds_secret(secret: &Token, headers: &HeaderMap) -> bool {
    let mut all = headers.get_all(AUTHORIZATION).iter();
    let given = all.next().and_then(|value| value.to_str().ok()).and_then(|v| v.strip_prefix("Bearer "));
    all.next().is_none() && given.is_some_and(|given| secret.is(given))
}

#[cfg(test)]
mod tests {
    use super::*;
    use hyper::header::HeaderName;

    fn access() -> AccessCheck {
        AccessCheck::new(Token("00112233445566778899aabbccddeeff".into()), 4000)
    }

    fn admit(method: Method, headers: &[(&str, &str)], path: &str) -> Result<String, Refusal> {
        let mut map = HeaderMap::new();
        for (name, value) in headers {
            map.append(name.parse::<HeaderName>().unwrap(), value.parse().unwrap());
        }
        access().admit(&method, &map, path).map(str::to_owned)
    }

    const PATH: &str = "/00112233445566778899aabbccddeeff/scene";
    const HERE: (&str, &str) = ("host", "127.0.0.1:4000");

    #[test]
    fn a_request_with_the_token_is_let_in() {
        assert_eq!(admit(Method::GET, &[HERE], PATH).unwrap(), "scene");
        assert_eq!(admit(Method::HEAD, &[("host", "localhost:4000")], PATH).unwrap(), "scene");
        let own = [HERE, ("origin", "http://127.0.0.1:4000"), ("sec-fetch-site", "same-origin")];
        assert_eq!(admit(Method::GET, &own, PATH).unwrap(), "scene");
        assert_eq!(admit(Method::GET, &[HERE, ("sec-fetch-site", "none")], PATH).unwrap(), "scene");
        for forwarded in ["localhost:9000", "127.0.0.1:9000", "[::1]:9000"] {
            let origin = format!("http://{forwarded}");
            let own = [("host", forwarded), ("origin", &origin), ("sec-fetch-site", "same-origin")];
            assert_eq!(admit(Method::GET, &own, PATH).unwrap(), "scene");
        }
        assert_eq!(access().address(), "http://127.0.0.1:4000/00112233445566778899aabbccddeeff/");
    }

    #[test]
    fn a_request_without_the_token_is_refused() {
        for path in
            ["/", "/scene", "//scene", "/00112233445566778899aabbccddeefe/", "/0011/", "", &PATH[..33]]
        {
            assert_eq!(admit(Method::GET, &[HERE], path), Err(Refusal::Token), "{path}");
        }
        for host in [
            "evil.example",
            "127.0.0.1",
            "localhost:port",
            "localhost.evil.example:4000",
            "evil.example:4000",
            "127.0.0.1:4000.evil.example",
        ] {
            assert_eq!(admit(Method::GET, &[("host", host)], PATH), Err(Refusal::Host), "{host}");
        }
        assert_eq!(admit(Method::GET, &[], PATH), Err(Refusal::Host));
        assert_eq!(admit(Method::GET, &[HERE, ("host", "evil.example")], PATH), Err(Refusal::Host));
        for origin in ["http://evil.example", "null", "https://127.0.0.1:4000", "http://127.0.0.1:80"] {
            assert_eq!(
                admit(Method::GET, &[HERE, ("origin", origin)], PATH),
                Err(Refusal::Origin),
                "{origin}"
            );
        }
        for site in ["cross-site", "same-site", "anything"] {
            assert_eq!(admit(Method::GET, &[HERE, ("sec-fetch-site", site)], PATH), Err(Refusal::Origin));
        }
        for method in [Method::POST, Method::PUT, Method::DELETE, Method::OPTIONS, Method::PATCH] {
            assert_eq!(admit(method, &[HERE], PATH), Err(Refusal::Method));
        }
    }

    #[test]
    fn only_the_document_of_a_frame_comes_from_another_page() {
        let admitted = |headers: &[(&str, &str)], path: &str| {
            let mut map = HeaderMap::new();
            for (name, value) in headers {
                map.append(name.parse::<HeaderName>().unwrap(), value.parse().unwrap());
            }
            access().admit_frame(&Method::GET, &map, path).map(str::to_owned)
        };
        let [site, dest, mode] =
            [("sec-fetch-site", "cross-site"), ("sec-fetch-dest", "iframe"), ("sec-fetch-mode", "navigate")];
        assert_eq!(admitted(&[HERE, site, dest, mode], PATH).unwrap(), "scene");
        assert_eq!(admitted(&[HERE, site, mode], PATH), Err(Refusal::Origin));
        assert_eq!(admitted(&[HERE, site, dest, ("sec-fetch-mode", "cors")], PATH), Err(Refusal::Origin));
        let origin = ("origin", "http://evil.example");
        assert_eq!(admitted(&[HERE, site, dest, mode, origin], PATH), Err(Refusal::Origin));
        assert_eq!(admitted(&[HERE, site, dest, mode], "/scene"), Err(Refusal::Token));
        assert_eq!(admit(Method::GET, &[HERE, site, dest, mode], PATH), Err(Refusal::Origin));
    }

    #[test]
    fn tokens_differ() {
        let (a, b) = (Token::random().unwrap(), Token::random().unwrap());
        assert!(a != b && a.text().len() == 32 && a.is(a.text()) && !a.is(b.text()));
    }
}

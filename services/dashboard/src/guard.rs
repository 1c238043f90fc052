//! Who may look, and who may change something.
//!
//! A page of another site must not reach the dashboard through the browser of somebody who can: requests have to name
//! the host by its address or as `localhost` (a name could have been made to point here: DNS rebinding), changes must not
//! come from another origin, and need the token.

use axum::http::{HeaderMap, StatusCode, header};
use sha2::{Digest, Sha256};
use std::net::IpAddr;

/// What lets somebody change the run. Only its hash is kept.
#[derive(Clone)]
pub struct Token([u8; 32]);

/// Why a text is no token.
#[derive(Debug, thiserror::Error, PartialEq, Eq)]
#[error("a token has {least} to {most} characters, letters, digits and -._~ only", least = Token::LENGTHS.start(), most = Token::LENGTHS.end())]
pub struct BadToken;

impl std::fmt::Debug for Token {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Token")
    }
}

impl Token {
    /// How many characters it may have.
    pub const LENGTHS: std::ops::RangeInclusive<usize> = 16..=128;

    /// The token of this text.
    ///
    /// # Errors
    /// When it is too short to be safe, too long, or would not survive in a URL.
    pub fn new(text: &str) -> Result<Self, BadToken> {
        let plain = |b: u8| b.is_ascii_alphanumeric() || b"-._~".contains(&b);
        if !Self::LENGTHS.contains(&text.len()) || !text.bytes().all(plain) {
            return Err(BadToken);
        }
        Ok(Self(Sha256::digest(text.as_bytes()).into()))
    }

    /// Whether this is the text. How long that takes says nothing about where they differ: hashes are compared, and all
    /// of their bytes.
    fn is(&self, text: &str) -> bool {
        let other: [u8; 32] = Sha256::digest(text.as_bytes()).into();
        let differs = self.0.iter().zip(&other).fold(0u8, |all, (a, b)| all | (a ^ b));
        std::hint::black_box(differs) == 0
    }
}

/// What a refused request is told.
pub(crate) type Refused = (StatusCode, &'static str);

/// The host that a request names, without its port.
fn host_of(host: &str) -> Option<&str> {
    if let Some(rest) = host.strip_prefix('[') {
        let (address, port) = rest.split_once(']')?;
        let sound = port.is_empty() || port.strip_prefix(':').is_some_and(is_port);
        return sound.then_some(address);
    }
    match host.split_once(':') {
        Some((name, port)) => is_port(port).then_some(name),
        None => Some(host),
    }
}

fn is_port(text: &str) -> bool {
    !text.is_empty() && text.bytes().all(|b| b.is_ascii_digit())
}

fn single<'h>(headers: &'h HeaderMap, name: &header::HeaderName) -> Option<&'h str> {
    let mut all = headers.get_all(name).iter();
    match (all.next(), all.next()) {
        (Some(value), None) => value.to_str().ok(),
        _ => None,
    }
}

/// Whether a request names this host in a way that nobody else can have made to point here.
pub(crate) fn check_host(headers: &HeaderMap) -> Result<(), Refused> {
    let host = single(headers, &header::HOST).and_then(host_of);
    let known = |name: &str| name.eq_ignore_ascii_case("localhost") || name.parse::<IpAddr>().is_ok();
    if host.is_some_and(known) {
        Ok(())
    } else {
        Err((
            StatusCode::FORBIDDEN,
            "open the dashboard by the machine's address or as localhost, not by another name",
        ))
    }
}

/// Whether a request may change something.
pub(crate) fn check_change(headers: &HeaderMap, token: Option<&Token>) -> Result<(), Refused> {
    let Some(token) = token else {
        return Err((
            StatusCode::FORBIDDEN,
            "this dashboard is read-only; start the run with --allow-control to change it from here",
        ));
    };
    if headers.contains_key(header::ORIGIN) {
        let origin = single(headers, &header::ORIGIN).and_then(|o| o.strip_prefix("http://"));
        let host = single(headers, &header::HOST);
        if origin.is_none() || origin != host {
            return Err((
                StatusCode::FORBIDDEN,
                "a page of another site asks for this; it is refused",
            ));
        }
    }
    let json = single(headers, &header::CONTENT_TYPE).is_some_and(|kind| {
        let kind = kind.split(';').next().unwrap_or_default();
        kind.trim().eq_ignore_ascii_case("application/json")
    });
    if !json {
        return Err((
            StatusCode::UNSUPPORTED_MEDIA_TYPE,
            "send JSON, with the header Content-Type: application/json",
        ));
    }
    let given = single(headers, &header::AUTHORIZATION).and_then(|value| value.strip_prefix("Bearer "));
    match given {
        Some(text) if token.is(text.trim()) => Ok(()),
        Some(_) => Err((StatusCode::UNAUTHORIZED, "the token is wrong")),
        None => Err((
            StatusCode::UNAUTHORIZED,
            "a token is needed: send the header Authorization: Bearer TOKEN",
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TOKEN: &str = "0123456789abcdef";

    fn headers(all: &[(header::HeaderName, &str)]) -> HeaderMap {
        let mut map = HeaderMap::new();
        for (name, value) in all {
            map.append(name.clone(), value.parse().unwrap());
        }
        map
    }

    #[test]
    fn hosts_are_addresses_or_localhost() {
        let code = |host: &str| check_host(&headers(&[(header::HOST, host)])).map_err(|(code, _)| code);
        for good in [
            "127.0.0.1:8080",
            "127.0.0.1",
            "localhost:1",
            "LocalHost",
            "[::1]:8080",
            "[::1]",
            "10.0.0.7:80",
        ] {
            assert_eq!(code(good), Ok(()), "{good}");
        }
        for bad in [
            "evil.example",
            "evil.example:8080",
            "127.0.0.1.evil.example",
            "localhost.evil",
            "",
            "[::1",
            "[::1]x",
            "127.0.0.1:",
            "::1",
            "127.0.0.1:8080:1",
        ] {
            assert_eq!(code(bad), Err(StatusCode::FORBIDDEN), "{bad}");
        }
        assert!(check_host(&HeaderMap::new()).is_err());
        let twice = headers(&[(header::HOST, "localhost"), (header::HOST, "localhost")]);
        assert!(check_host(&twice).is_err());
    }

    #[test]
    fn changes_need_the_token_and_no_other_origin() {
        let token = Token::new(TOKEN).unwrap();
        let bearer = format!("Bearer {TOKEN}");
        let base = [
            (header::HOST, "127.0.0.1:8080"),
            (header::CONTENT_TYPE, "application/json; charset=utf-8"),
        ];
        let with = |more: &[(header::HeaderName, &str)]| {
            check_change(&headers(&[&base[..], more].concat()), Some(&token))
                .map_err(|(code, _)| code.as_u16())
        };
        let good = (header::AUTHORIZATION, bearer.as_str());
        assert_eq!(with(std::slice::from_ref(&good)), Ok(()));
        assert_eq!(
            with(&[good.clone(), (header::ORIGIN, "http://127.0.0.1:8080")]),
            Ok(())
        );
        for origin in [
            "http://evil.example",
            "null",
            "https://127.0.0.1:8080",
            "http://127.0.0.1:8081",
        ] {
            assert_eq!(
                with(&[good.clone(), (header::ORIGIN, origin)]),
                Err(403),
                "{origin}"
            );
        }
        assert_eq!(with(&[]), Err(401));
        for wrong in [
            "Bearer ",
            "Bearer 0123456789abcdeF",
            "Bearer 0123456789abcdef0",
            "Basic 0123456789abcdef",
        ] {
            assert_eq!(with(&[(header::AUTHORIZATION, wrong)]), Err(401), "{wrong}");
        }
        let read_only = check_change(&headers(std::slice::from_ref(&good)), None);
        assert_eq!(read_only.unwrap_err().0, StatusCode::FORBIDDEN);
        let form = headers(&[good, (header::CONTENT_TYPE, "text/plain")]);
        assert_eq!(
            check_change(&form, Some(&token)).unwrap_err().0,
            StatusCode::UNSUPPORTED_MEDIA_TYPE
        );
    }

    #[test]
    fn tokens_are_long_enough_and_plain() {
        for bad in [
            "",
            "short",
            "0123456789abcde",
            "0123456789 abcdef",
            "0123456789abcdeé",
            &"x".repeat(129),
        ] {
            assert_eq!(Token::new(bad).unwrap_err(), BadToken, "{bad}");
        }
        assert!(Token::new(&"x".repeat(128)).is_ok());
        assert_eq!(
            format!("{:?}", Token::new(TOKEN).unwrap()),
            "Token",
            "it is not printed"
        );
    }
}

//! The head of a request.

use embassy_net::IpEndpoint;

use super::status::Status;

/// The method of a request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Method {
    /// Requests a page.
    Get,
    /// Requests the head of a page.
    Head,
    /// Sends a body.
    Post,
}

/// A valid request without its body. A request that has a header twice is invalid.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub struct Request<'a> {
    /// The client.
    pub client: Option<IpEndpoint>,
    /// The method.
    pub method: Method,
    /// The path, without its query.
    pub path: &'a str,
    /// The header `Host`.
    pub host: Option<&'a str>,
    /// The header `Origin`: the site whose page makes the request.
    pub origin: Option<&'a str>,
    /// The header `Authorization`.
    pub authorization: Option<&'a str>,
    /// The header `Content-Type`.
    pub content_type: Option<&'a str>,
    /// The header `Content-Length`.
    pub length: Option<&'a str>,
}

/// Returns the length of the head in received bytes, with its empty line; `None` if it is not complete.
pub(super) fn head_len(bytes: &[u8]) -> Option<usize> {
    bytes.windows(4).position(|end| end == b"\r\n\r\n").map(|at| at.saturating_add(4))
}

impl<'a> Request<'a> {
    /// Parses the head of a request.
    pub(super) fn parse(bytes: &'a [u8], client: Option<IpEndpoint>) -> Result<Self, Status> {
        let line = bytes.split(|byte| *byte == b'\r').next().unwrap_or_default();
        let line = core::str::from_utf8(line).map_err(|_| Status::BadRequest)?;
        let mut words = line.split(' ');
        let (Some(method), Some(target), Some(version), None) =
            (words.next(), words.next(), words.next(), words.next())
        else {
            return Err(Status::BadRequest);
        };
        if !version.starts_with("HTTP/1.") || !target.starts_with('/') {
            return Err(Status::BadRequest);
        }
        let len = head_len(bytes).ok_or(Status::HeaderTooLarge)?;
        let method = match method {
            "GET" => Method::Get,
            "HEAD" => Method::Head,
            "POST" => Method::Post,
            _ => return Err(Status::MethodNotAllowed),
        };
        let mut request = Self {
            client,
            method,
            path: target.split('?').next().unwrap_or_default(),
            host: None,
            origin: None,
            authorization: None,
            content_type: None,
            length: None,
        };
        let head = bytes.get(..len).unwrap_or_default();
        head.split(|byte| *byte == b'\n').skip(1).try_for_each(|line| request.add(line))?;
        Ok(request)
    }

    /// Adds a header.
    fn add(&mut self, line: &'a [u8]) -> Result<(), Status> {
        // the names below are ASCII, so a line that is not UTF-8 is another header
        let Some((name, value)) = core::str::from_utf8(line).ok().and_then(|line| line.split_once(':')) else {
            return Ok(());
        };
        let places = [
            ("host", &mut self.host),
            ("origin", &mut self.origin),
            ("authorization", &mut self.authorization),
            ("content-type", &mut self.content_type),
            ("content-length", &mut self.length),
        ];
        for (known, place) in places {
            if name.eq_ignore_ascii_case(known) && place.replace(value.trim()).is_some() {
                return Err(Status::BadRequest);
            }
        }
        // a body in chunks has no length
        if name.eq_ignore_ascii_case("transfer-encoding") { Err(Status::LengthRequired) } else { Ok(()) }
    }

    /// Returns the length of the body, for which there is this much memory.
    pub(super) fn body_len(&self, memory: usize) -> Result<usize, Status> {
        let digits = self.length.ok_or(Status::LengthRequired)?;
        if digits.is_empty() || !digits.bytes().all(|digit| digit.is_ascii_digit()) {
            return Err(Status::BadRequest);
        }
        digits.parse().ok().filter(|len| *len <= memory).ok_or(Status::ContentTooLarge)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: Request<'_> = Request {
        client: None,
        method: Method::Get,
        path: "/",
        host: None,
        origin: None,
        authorization: None,
        content_type: None,
        length: None,
    };

    #[test]
    fn requests_are_parsed_or_refused() {
        for (head, expected) in [
            ("GET / HTTP/1.1\r\n\r\n", Ok(NONE)),
            (
                "GET /health.json?x=1 HTTP/1.0\r\nHost: a\r\n\r\n",
                Ok(Request { path: "/health.json", host: Some("a"), ..NONE }),
            ),
            ("HEAD / HTTP/1.1\r\n\r\n", Ok(Request { method: Method::Head, ..NONE })),
            (
                "POST /s HTTP/1.1\r\nhost:10.0.0.9\r\nORIGIN: http://10.0.0.9 \r\nAuthorization: Basic OnA=\r\n\
                 Content-Type: text/plain\r\nContent-Length: 12\r\nHost : b\r\n Host: c\r\n\r\nHost: d",
                Ok(Request {
                    method: Method::Post,
                    path: "/s",
                    host: Some("10.0.0.9"),
                    origin: Some("http://10.0.0.9"),
                    authorization: Some("Basic OnA="),
                    content_type: Some("text/plain"),
                    length: Some("12"),
                    ..NONE
                }),
            ),
            ("PUT /settings HTTP/1.1\r\n\r\n", Err(Status::MethodNotAllowed)),
            ("GET / HTTP/1.1\r\nCookie: ...", Err(Status::HeaderTooLarge)),
            ("GET / HTTP/2\r\n\r\n", Err(Status::BadRequest)),
            ("GET  / HTTP/1.1\r\n\r\n", Err(Status::BadRequest)),
            ("GET http://a/ HTTP/1.1\r\n\r\n", Err(Status::BadRequest)),
            ("GET / HTTP/1.1\r\nHost: a\r\nhost: b\r\n\r\n", Err(Status::BadRequest)),
            ("POST / HTTP/1.1\r\nContent-Length: 1\r\nContent-Length: 1\r\n\r\n", Err(Status::BadRequest)),
            ("POST / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n", Err(Status::LengthRequired)),
            ("GET:RC8:1:I:\r\n\r\n", Err(Status::BadRequest)),
            ("", Err(Status::BadRequest)),
        ] {
            assert_eq!(Request::parse(head.as_bytes(), None), expected, "{head:?}");
        }
        assert_eq!(Request::parse(b"GET /\xff HTTP/1.1\r\n\r\n", None), Err(Status::BadRequest));
        assert_eq!(Request::parse(b"GET / HTTP/1.1\r\nCookie: \xff\r\n\r\n", None), Ok(NONE));
    }

    #[test]
    fn a_body_has_a_length_that_fits() {
        for (length, expected) in [
            (Some("0"), Ok(0)),
            (Some("64"), Ok(64)),
            (Some("65"), Err(Status::ContentTooLarge)),
            (Some("99999999999999999999999"), Err(Status::ContentTooLarge)),
            (Some("+1"), Err(Status::BadRequest)),
            (Some("-1"), Err(Status::BadRequest)),
            (Some(""), Err(Status::BadRequest)),
            (None, Err(Status::LengthRequired)),
        ] {
            assert_eq!(Request { length, ..NONE }.body_len(64), expected, "{length:?}");
        }
    }
}

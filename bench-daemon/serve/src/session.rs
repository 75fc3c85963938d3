//! Sessions of browsers. A browser that presents a token once gets a cookie that scripts cannot
//! read. Only the SHA-256 of the session number and of the token are kept, in memory: a restarted
//! server has no sessions.

use std::{
    collections::BTreeMap,
    sync::{Mutex, PoisonError},
};

use super::token::{self, TokenError};
use bench_plan::support::hash;

/// Name of the cookie.
pub const COOKIE: &str = "eis_bench_session";
/// Header that a request with a cookie must carry if it changes something. A page of another
/// origin cannot send it without a preflight request to this server (OWASP, custom request
/// headers against forged requests).
pub const PROOF_HEADER: &str = "x-eis-bench";
/// Longest session, s (NIST SP 800-63B, 4.2.3: to show the token again after 12 h at most).
pub const LONGEST_S: f64 = 12.0 * 3600.0;
/// Most sessions of a token; its oldest is ended for a new one.
const MOST: usize = 20;

/// A session.
#[derive(Debug, Clone)]
struct Session {
    token_sha256: String,
    until_s: f64,
}

/// All sessions, by the SHA-256 of their numbers.
#[derive(Debug, Default)]
pub struct Sessions(Mutex<BTreeMap<String, Session>>);

impl Sessions {
    /// Begins a session for a token; gives its number. Numbers are made here, and nowhere else.
    ///
    /// # Errors
    /// A system without random numbers.
    pub fn begin(&self, token: &str, now_s: f64) -> Result<String, TokenError> {
        let number = token::random()?;
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.retain(|_, session| session.until_s > now_s);
        let token_sha256 = hash::sha256(token);
        let mut own: Vec<(f64, String)> = all
            .iter()
            .filter(|(_, session)| session.token_sha256 == token_sha256)
            .map(|(number, session)| (session.until_s, number.clone()))
            .collect();
        own.sort_by(|a, b| b.0.total_cmp(&a.0));
        for (_, number) in own.iter().skip(MOST - 1) {
            all.remove(number);
        }
        let session = Session {
            token_sha256,
            until_s: now_s + LONGEST_S,
        };
        all.insert(hash::sha256(&number), session);
        Ok(number)
    }

    /// The SHA-256 of the token of a session. Whether it still opens anything is asked anew with each
    /// request.
    pub fn token_sha256(&self, number: &str, now_s: f64) -> Option<String> {
        let all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let session = all.get(&hash::sha256(number))?;
        (session.until_s > now_s).then(|| session.token_sha256.clone())
    }

    /// Ends a session.
    pub fn end(&self, number: &str) {
        let mut all = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        all.remove(&hash::sha256(number));
    }
}

/// The number of the session among the cookies of a request.
pub fn number(cookies: &str) -> Option<&str> {
    let named =
        |pair: &'_ str| -> bool { pair.split_once('=').is_some_and(|(name, _)| name == COOKIE) };
    let pair = cookies.split(';').map(str::trim).find(|pair| named(pair))?;
    pair.split_once('=').map(|(_, number)| number)
}

/// Returns the cookie of a session; `None` as number ends the session in the browser.
pub fn cookie(number: Option<&str>, encrypted: bool) -> String {
    let secure = if encrypted { "; Secure" } else { "" };
    let (number, age_s) = number.map_or(("", 0.0), |number| (number, LONGEST_S));
    format!("{COOKIE}={number}; Path=/; HttpOnly; SameSite=Strict; Max-Age={age_s}{secure}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_session_ends_by_itself_and_when_it_is_ended() {
        let sessions = Sessions::default();
        let (a, b) = (
            sessions.begin("eb_1", 0.0).unwrap(),
            sessions.begin("eb_1", 10.0).unwrap(),
        );
        assert_ne!(a, b);
        assert_eq!(sessions.token_sha256(&a, 1.0), Some(hash::sha256("eb_1")));
        assert_eq!(sessions.token_sha256(&a, LONGEST_S), None);
        sessions.end(&b);
        assert_eq!(sessions.token_sha256(&b, 11.0), None);
        let many: Vec<String> = (0..25)
            .map(|k| sessions.begin("eb_2", f64::from(k)).unwrap())
            .collect();
        let left = many
            .iter()
            .filter(|one| sessions.token_sha256(one, 30.0).is_some())
            .count();
        assert_eq!(left, MOST, "of another token");
        assert!(
            sessions.token_sha256(&a, 30.0).is_some()
                && sessions.token_sha256(&many[0], 30.0).is_none()
        );
        assert_eq!(sessions.token_sha256("chosen by somebody else", 1.0), None);
    }

    #[test]
    fn the_cookie_is_found_among_others_and_is_not_for_scripts() {
        assert_eq!(number("a=b; eis_bench_session=12; c=d"), Some("12"));
        assert_eq!(number("eis_bench_session2=12; a=eis_bench_session=3"), None);
        let made = cookie(Some("12"), true);
        assert_eq!(
            made,
            "eis_bench_session=12; Path=/; HttpOnly; SameSite=Strict; Max-Age=43200; Secure"
        );
        assert!(cookie(None, false).contains("Max-Age=0"));
    }
}

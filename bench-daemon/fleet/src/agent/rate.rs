//! Limits the request rate of each peer, because each request to the agent causes one to the
//! server.

use std::{
    collections::HashMap,
    net::IpAddr,
    sync::{Mutex, PoisonError},
};

/// Maximum number of peers that are remembered.
const PEERS: usize = 10_000;

/// A token bucket for each peer.
pub(crate) struct Rate {
    per_s: f64,
    burst: f64,
    buckets: Mutex<HashMap<IpAddr, Bucket>>,
}

struct Bucket {
    left: f64,
    seen_s: f64,
}

impl Rate {
    /// Allows `per_s` requests per second on average, and bursts of `burst`.
    pub(crate) fn new(per_s: f64, burst: f64) -> Self {
        Self {
            per_s,
            burst,
            buckets: Mutex::default(),
        }
    }

    /// Takes a token from the bucket of a peer. Returns whether one was available.
    pub(crate) fn take(&self, peer: IpAddr, now_s: f64) -> bool {
        let mut buckets = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        let refilled =
            |bucket: &Bucket| (bucket.left + (now_s - bucket.seen_s) * self.per_s).min(self.burst);
        if buckets.len() > PEERS {
            buckets.retain(|_, bucket| refilled(bucket) < self.burst);
        }
        let bucket = buckets.entry(peer).or_insert(Bucket {
            left: self.burst,
            seen_s: now_s,
        });
        let left = refilled(bucket);
        let is_enough = left >= 1.0;
        *bucket = Bucket {
            left: if is_enough { left - 1.0 } else { left },
            seen_s: now_s,
        };
        is_enough
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bucket_refills_and_each_peer_has_its_own() {
        let rate = Rate::new(2.0, 3.0);
        let (a, b) = (IpAddr::from([10, 0, 0, 1]), IpAddr::from([10, 0, 0, 2]));
        assert_eq!(
            [0.0, 0.0, 0.0, 0.0, 0.4, 0.6].map(|now_s| rate.take(a, now_s)),
            [true, true, true, false, false, true]
        );
        assert!(rate.take(b, 0.6) && !rate.take(a, 0.6));
    }
}

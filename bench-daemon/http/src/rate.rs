//! How often each peer may do something.

use std::{
    collections::HashMap,
    net::IpAddr,
    sync::{Mutex, PoisonError},
};

/// Maximum number of peers that are remembered.
const PEERS: usize = 10_000;

/// How often each peer may do something: a bucket that refills.
#[derive(Debug)]
pub struct Rate {
    per_s: f64,
    burst: f64,
    buckets: Mutex<HashMap<IpAddr, (f64, f64)>>,
}

impl Rate {
    /// So often per second, and so often at once.
    pub fn new(per_s: f64, burst: f64) -> Self {
        Self {
            per_s,
            burst,
            buckets: Mutex::default(),
        }
    }

    /// Takes one; whether there was one.
    pub fn take(&self, peer: IpAddr, now_s: f64) -> bool {
        let mut buckets = self.buckets.lock().unwrap_or_else(PoisonError::into_inner);
        if buckets.len() > PEERS {
            // A bucket that has had time to refill is dropped.
            buckets.retain(|_, (left, seen_s)| *left + (now_s - *seen_s) * self.per_s < self.burst);
        }
        let (left, seen_s) = buckets.entry(peer).or_insert((self.burst, now_s));
        *left = (*left + (now_s - *seen_s) * self.per_s).min(self.burst);
        *seen_s = now_s;
        let enough = *left >= 1.0;
        *left -= if enough { 1.0 } else { 0.0 };
        enough
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

//! A bounded cache of decoded pages, shared by threads.
//!
//! Sharded, so that readers of different pages seldom wait for each other; each shard evicts by the clock rule (a page
//! used since the hand last passed gets a second chance). What is kept changes how often the file is read, and nothing
//! else.

use std::{
    collections::HashMap,
    sync::{Mutex, MutexGuard, PoisonError},
};

const SHARDS: usize = 16;

struct Slot<V> {
    key: u64,
    value: V,
    bytes: usize,
    used: bool,
}

struct Shard<V> {
    slots: Vec<Slot<V>>,
    index: HashMap<u64, usize>,
    bytes: usize,
    hand: usize,
}

/// A cache of values by number, of a bounded total size.
pub(super) struct Cache<V> {
    shards: Vec<Mutex<Shard<V>>>,
    limit: usize,
}

impl<V: Clone> Cache<V> {
    /// A cache that keeps at most about `bytes`.
    pub(super) fn new(bytes: usize) -> Self {
        let shard = || Shard { slots: Vec::new(), index: HashMap::new(), bytes: 0, hand: 0 };
        Self { shards: (0..SHARDS).map(|_| Mutex::new(shard())).collect(), limit: bytes / SHARDS }
    }

    pub(super) fn get(&self, key: u64) -> Option<V> {
        let mut shard = self.shard(key);
        let n = *shard.index.get(&key)?;
        shard.slots[n].used = true;
        Some(shard.slots[n].value.clone())
    }

    /// Keeps `value`, which takes `bytes`, unless it is larger than a shard.
    pub(super) fn insert(&self, key: u64, value: V, bytes: usize) {
        let mut shard = self.shard(key);
        if bytes > self.limit || shard.index.contains_key(&key) {
            return;
        }
        while shard.bytes + bytes > self.limit && !shard.slots.is_empty() {
            shard.pass_hand();
        }
        let n = shard.slots.len();
        shard.index.insert(key, n);
        shard.slots.push(Slot { key, value, bytes, used: false });
        shard.bytes += bytes;
    }

    /// Keeps `value` in place of what was kept under its key.
    pub(super) fn replace(&self, key: u64, value: V, bytes: usize) {
        self.shard(key).remove(key);
        self.insert(key, value, bytes);
    }

    fn shard(&self, key: u64) -> MutexGuard<'_, Shard<V>> {
        // The high bits of a product with an odd constant (Knuth's multiplicative hash): all bits of the key count.
        let n = (key.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 32) as usize % SHARDS;
        // A thread that panicked while it held the lock left a valid shard: all steps keep it so.
        self.shards[n].lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<V> Shard<V> {
    fn pass_hand(&mut self) {
        if self.hand >= self.slots.len() {
            self.hand = 0;
        }
        if std::mem::take(&mut self.slots[self.hand].used) {
            self.hand += 1;
            return;
        }
        self.remove(self.slots[self.hand].key);
        // The last slot, the newest page, now lies here: the hand comes to it last.
        self.hand += 1;
    }

    fn remove(&mut self, key: u64) {
        let Some(n) = self.index.remove(&key) else { return };
        self.bytes -= self.slots.swap_remove(n).bytes;
        if let Some(moved) = self.slots.get(n) {
            self.index.insert(moved.key, n);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::synthetic::mix;

    #[test]
    fn it_keeps_what_was_put_in_and_stays_within_its_size() {
        let cache = Cache::new(SHARDS * 100);
        for n in 0..10_000_u64 {
            let key = mix(n) % 300;
            match cache.get(key) {
                Some(value) => assert_eq!(value, key * 7),
                None => cache.insert(key, key * 7, 1 + key as usize % 30),
            }
            let kept: usize = cache.shards.iter().map(|s| s.lock().unwrap().bytes).sum();
            assert!(kept <= SHARDS * 100);
        }
        for shard in &cache.shards {
            let shard = shard.lock().unwrap();
            assert_eq!(shard.index.len(), shard.slots.len());
            assert_eq!(shard.bytes, shard.slots.iter().map(|s| s.bytes).sum::<usize>());
            assert!(shard.slots.iter().enumerate().all(|(n, s)| shard.index[&s.key] == n));
        }
    }

    #[test]
    fn what_is_used_outlives_what_is_not() {
        let cache = Cache::new(SHARDS * 4);
        cache.insert(0, 7, 1);
        for key in 1..2000 {
            assert_eq!(cache.get(0), Some(7), "{key}");
            cache.insert(key, 0, 1);
        }
        assert_eq!((1..100).find_map(|key| cache.get(key)), None);
    }

    #[test]
    fn a_cache_of_no_size_keeps_nothing() {
        let cache = Cache::new(0);
        cache.insert(1, 1, 1);
        assert_eq!(cache.get(1), None);
    }
}

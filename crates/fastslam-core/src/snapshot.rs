//! States as bytes: a versioned container with a checksum.
//!
//! A snapshot holds what a later step needs and the configuration that it was made with, and nothing else; whoever goes
//! on from it gets the bits that the filter would have given without the cut. The crate knows no files: writing the
//! bytes is the caller's.

use crate::association::Identities;
use crate::config::Config;
use crate::error::{Error, Result};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// What every snapshot begins with.
const MAGIC: [u8; 8] = *b"fastslam";
/// Layout of what is stored. It goes up whenever a stored type changes; a stored file in the tests tells when.
pub const FORMAT: u32 = KEYFRAMES;
/// The oldest format that is still read.
const OLDEST_FORMAT: u32 = 2;
/// The first format with what a filter was given to begin with behind its state.
pub(crate) const GIVEN_MAPS: u32 = 3;
/// The first format with what makes landmarks fade behind that.
pub(crate) const FADING: u32 = 4;
/// The first format with the scans of a stream that wait.
pub(crate) const SCANS: u32 = 5;
/// The first format with what names say of drift behind that.
pub(crate) const RETURNS: u32 = 6;
/// The first format with a draw of paths under way behind that.
pub(crate) const BESIDE: u32 = 7;
/// The first format with how wrong the pose may be.
pub(crate) const ERRORS: u32 = 8;
/// The first format with several sensors: what is known of each, and which made what.
pub(crate) const SENSORS: u32 = 9;
/// The first format with what was seen lately of a kept map.
pub(crate) const KEPT_MAPS: u32 = 10;
/// The first format with a past of which old steps may be forgotten.
pub(crate) const KEYFRAMES: u32 = 11;
/// Magic, format, length of the content, checksum of the content.
const PREAMBLE: usize = MAGIC.len() + 4 + 8 + 4;

/// What a snapshot is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Holds {
    /// A filter between two calls.
    Filter,
    /// A run over a log.
    Run,
    /// A stream between two rows.
    Stream,
}

impl Holds {
    fn named(self) -> &'static str {
        match self {
            Self::Filter => "a filter",
            Self::Run => "a run over a log",
            Self::Stream => "a stream",
        }
    }
}

/// What a snapshot says before the state.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Head {
    /// What it is of.
    pub holds: Holds,
    /// Version of the crate that wrote it.
    pub program: String,
    /// The configuration as JSON.
    pub configuration: String,
    /// Which sightings come with an identity.
    pub identities: Identities,
    /// What the caller keeps with the state; the filter does not read it.
    pub note: String,
}

impl Head {
    /// Of a filter with this configuration.
    pub(crate) fn new(config: &Config, identities: Identities, note: &str) -> Result<Self> {
        Self::of(Holds::Filter, config, identities, note)
    }

    /// Of a run with this configuration.
    pub(crate) fn of_run(config: &Config, identities: Identities) -> Result<Self> {
        Self::of(Holds::Run, config, identities, "")
    }

    /// Of a stream with this configuration.
    pub(crate) fn of_stream(config: &Config, identities: Identities, note: &str) -> Result<Self> {
        Self::of(Holds::Stream, config, identities, note)
    }

    fn of(holds: Holds, config: &Config, identities: Identities, note: &str) -> Result<Self> {
        let configuration = serde_json::to_string(config).map_err(|e| Error::Input(format!("configuration: {e}")))?;
        let (program, note) = (env!("CARGO_PKG_VERSION").to_owned(), note.to_owned());
        Ok(Self { holds, program, configuration, identities, note })
    }

    /// The configuration, valid.
    pub fn config(&self) -> Result<Config> {
        let config: Config = serde_json::from_str(&self.configuration)
            .map_err(|e| refused(&format!("its configuration cannot be read ({e})")))?;
        config.validate()?;
        Ok(config)
    }

    /// An error that names the first key in which a snapshot was made otherwise. Threads change no result, and may
    /// differ.
    pub(crate) fn check(&self, config: &Config, identities: Identities) -> Result<()> {
        let wanted = Self::new(config, identities, "")?;
        // Read as a configuration, so that keys that came later have their defaults.
        let [theirs, ours] = [&self.config()?, config].map(|config| serde_json::to_value(config).unwrap_or_default());
        if let Some((key, theirs, ours)) = first_difference("", &without_threads(theirs), &without_threads(ours)) {
            return Err(refused(&format!("it was made with {key} = {theirs}, not {ours}")));
        }
        if self.identities != wanted.identities {
            let (theirs, ours) = (self.identities, wanted.identities);
            return Err(refused(&format!("it was made for identities of {theirs:?} sightings, not of {ours:?}")));
        }
        Ok(())
    }
}

fn refused(why: &str) -> Error {
    Error::Input(format!("the snapshot is refused: {why}"))
}

fn without_threads(mut config: Value) -> Value {
    if let Some(filter) = config.get_mut("filter").and_then(Value::as_object_mut) {
        filter.remove("threads");
    }
    config
}

/// Dotted key and both values of the first thing that differs.
fn first_difference(key: &str, a: &Value, b: &Value) -> Option<(String, Value, Value)> {
    if let (Value::Object(a), Value::Object(b)) = (a, b) {
        let names = a.keys().chain(b.keys().filter(|name| !a.contains_key(*name)));
        let dot = if key.is_empty() { "" } else { "." };
        let of = |map: &serde_json::Map<String, Value>, name: &String| map.get(name).cloned().unwrap_or_default();
        return names.filter_map(|n| first_difference(&format!("{key}{dot}{n}"), &of(a, n), &of(b, n))).next();
    }
    (a != b).then(|| (key.to_owned(), a.clone(), b.clone()))
}

/// Of the content, and of the format that says how to read it; up to format 2 of the content alone.
fn checksum_of(format: u32, stored: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    if format > 2 {
        hasher.update(&format.to_le_bytes());
    }
    hasher.update(stored);
    hasher.finalize()
}

/// A container around a head and what follows it.
pub(crate) fn seal(head: &Head, content: &impl Serialize) -> Result<Vec<u8>> {
    let mut bytes = vec![0; PREAMBLE];
    let failed = |e: postcard::Error| Error::Input(format!("the state cannot be stored: {e}"));
    bytes = postcard::to_extend(head, bytes).map_err(failed)?;
    bytes = postcard::to_extend(content, bytes).map_err(failed)?;
    let (preamble, stored) = bytes.split_at_mut(PREAMBLE);
    let checksum = checksum_of(FORMAT, stored);
    preamble[..8].copy_from_slice(&MAGIC);
    preamble[8..12].copy_from_slice(&FORMAT.to_le_bytes());
    preamble[12..20].copy_from_slice(&(stored.len() as u64).to_le_bytes());
    preamble[20..].copy_from_slice(&checksum.to_le_bytes());
    Ok(bytes)
}

/// The head of a container, and what follows it as bytes.
///
/// **Errors:** [`Error::Input`] when the bytes are no snapshot, of another format, cut off, damaged, or of something else.
pub(crate) fn open(bytes: &[u8], wanted: Holds) -> Result<(Head, Stored<'_>)> {
    let (head, stored) = unsealed(bytes)?;
    if head.holds != wanted {
        return Err(refused(&format!("it is of {}, not of {}", head.holds.named(), wanted.named())));
    }
    Ok((head, stored))
}

fn unsealed(bytes: &[u8]) -> Result<(Head, Stored<'_>)> {
    let Some((preamble, stored)) = bytes.split_at_checked(PREAMBLE).filter(|(start, _)| start[..8] == MAGIC) else {
        return Err(refused("it is no snapshot of fastslam"));
    };
    let number = |from: usize, length: usize| {
        preamble[from..from + length].iter().rev().fold(0_u64, |sum, byte| sum << 8 | u64::from(*byte))
    };
    let (format, length, checksum) = (number(8, 4), number(12, 8), number(20, 4));
    if !(u64::from(OLDEST_FORMAT)..=u64::from(FORMAT)).contains(&format) {
        let age = if format > u64::from(FORMAT) { "a newer" } else { "an older" };
        let range = format!("{OLDEST_FORMAT} to {FORMAT}");
        return Err(refused(&format!("it is of {age} format, {format}; this version reads {range}")));
    }
    if length != stored.len() as u64 {
        return Err(refused(&format!("it is cut off or overlong: {} bytes of content, not {length}", stored.len())));
    }
    if checksum != u64::from(checksum_of(format as u32, stored)) {
        return Err(refused("it is damaged (the checksum differs)"));
    }
    let (head, bytes) =
        postcard::take_from_bytes(stored).map_err(|e| refused(&format!("its head cannot be read ({e})")))?;
    Ok((head, Stored { bytes, format: format as u32 }))
}

/// What follows the head.
#[derive(Debug)]
pub(crate) struct Stored<'a> {
    bytes: &'a [u8],
    /// How it is laid out.
    pub format: u32,
}

/// What was stored.
pub(crate) fn content<T: DeserializeOwned>(stored: &Stored<'_>) -> Result<T> {
    match postcard::take_from_bytes(stored.bytes) {
        Ok((content, [])) => Ok(content),
        Ok((_, rest)) => Err(refused(&format!("{} bytes are left over", rest.len()))),
        Err(error) => Err(refused(&format!("its state cannot be read ({error})"))),
    }
}

/// What a snapshot says of itself: configuration and identities.
///
/// **Errors:** [`Error::Input`] when the bytes are no snapshot, of another format, cut off or damaged.
pub fn head(bytes: &[u8]) -> Result<Head> {
    Ok(unsealed(bytes)?.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sealed() -> Vec<u8> {
        seal(&Head::new(&Config::default(), Identities::All, "a note").unwrap(), &(7_u32, "state".to_owned())).unwrap()
    }

    #[test]
    fn what_was_sealed_is_opened_and_any_damage_is_found() {
        let bytes = sealed();
        let (head, stored) = unsealed(&bytes).unwrap();
        assert_eq!((head.config().unwrap(), head.note.as_str()), (Config::default(), "a note"));
        assert_eq!(content::<(u32, String)>(&stored).unwrap(), (7, "state".to_owned()));
        for place in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[place] ^= 1 << (place % 8);
            assert!(unsealed(&damaged).is_err(), "byte {place}");
            assert!(unsealed(&bytes[..place]).is_err(), "cut at {place}");
        }
    }

    #[test]
    fn a_refusal_says_why() {
        let message = |bytes: &[u8]| open(bytes, Holds::Filter).unwrap_err().to_string();
        assert!(message(b"PK").contains("no snapshot of fastslam"));
        let mut newer = sealed();
        newer[8] += 1;
        assert!(message(&newer).contains("a newer format, 12; this version reads 2 to 11"));
        assert!(message(&sealed()[..99]).contains("cut off"));
        let of_a_run = seal(&Head::of_run(&Config::default(), Identities::All).unwrap(), &0).unwrap();
        assert!(message(&of_a_run).contains("of a run"));
    }

    #[test]
    fn another_configuration_is_named_by_its_first_key_and_threads_may_differ() {
        let check = |config: &Config| {
            Head::new(config, Identities::All, "").unwrap().check(&Config::default(), Identities::All)
        };
        let mut config = Config::default();
        config.filter.threads = 2;
        assert_eq!(check(&config), Ok(()));
        config.filter.particles = 7;
        let refusal = check(&config).unwrap_err().to_string();
        assert!(refusal.ends_with("it was made with filter.particles = 7, not 100"), "{refusal}");
    }
}

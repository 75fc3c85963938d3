//! The bipolar supply of a bench: a model with a link, or an analog one, which the generator alone
//! commands.

use instruments::{
    supply4q::{self, Rating},
    units::{Amps, Hertz, Seconds},
};

use super::{
    ConfigError, Instrument, Source,
    bench::{ANALOG, ANSWER_S, Analog},
    quantity::{Duration, Quantity},
    raw_bench,
};

/// Range of the magnitude of its gain, A/V.
const GAIN: (f64, f64) = (0.01, 100.0);
/// Greatest rated current, A.
const GREATEST_A: Amps = Amps(400.0);
/// Range of its greatest frequency, and its default, Hz.
const FOLLOWS_HZ: (Hertz, Hertz) = (Hertz(1.0), Hertz(1.0e5));
const FOLLOWS: Hertz = Hertz(300.0);

/// The bipolar supply as resolved: at most one of the two.
#[derive(Default)]
pub(super) struct Resolved {
    pub(super) linked: Option<Instrument>,
    pub(super) analog: Option<Analog>,
}

impl Resolved {
    /// Volts at the input for one ampere of charge, without trim. Without a supply it is not a
    /// number, and no generator takes that.
    pub(super) fn volts_per_amp(&self) -> f64 {
        let linked = self.linked.as_ref().and_then(|supply| {
            let can = supply4q::dialect(&supply.model, supply.rating).ok()?;
            let can = can.capabilities();
            Some(can.analog_full_scale.value() / can.full_scale.value())
        });
        linked
            .or_else(|| self.analog.map(|analog| 1.0 / analog.amps_per_volt))
            .unwrap_or(f64::NAN)
    }
}

pub(super) fn resolve(
    source: &Source,
    raw: Option<&raw_bench::Supply4q>,
) -> Result<Resolved, ConfigError> {
    let Some(raw) = raw else {
        return Ok(Resolved::default());
    };
    let field = |name: &str| format!("instruments.supply4q.{name}");
    let refuse = |name: &str, present: bool, reason: &str| {
        if present {
            Err(source.complain(&field(name), reason))
        } else {
            Ok(())
        }
    };
    if raw.model == ANALOG {
        let none = "expected none: an analog supply has no link";
        refuse("address", raw.address.is_some(), none)?;
        refuse("accept", raw.accept.is_some(), none)?;
        refuse("answer", raw.answer.is_some(), none)?;
        let rated = "expected full_scale: an analog supply has no identity with a rating";
        refuse("rating", raw.rating.is_some(), rated)?;
        return Ok(Resolved {
            linked: None,
            analog: Some(analog(source, raw)?),
        });
    }
    let own = "expected none: only the model \"analog\" needs it, and the other models have theirs";
    refuse("gain", raw.gain.is_some(), own)?;
    refuse("full_scale", raw.full_scale.is_some(), own)?;
    refuse("max_frequency", raw.max_frequency.is_some(), own)?;
    Ok(Resolved {
        linked: Some(linked(source, raw)?),
        analog: None,
    })
}

fn analog(source: &Source, raw: &raw_bench::Supply4q) -> Result<Analog, ConfigError> {
    let missing = |name: &str, reason: &str| {
        source.complain(&format!("instruments.supply4q.{name}"), reason.to_owned())
    };
    let gain = raw
        .gain
        .ok_or_else(|| {
            missing(
                "gain",
                "expected the gain of the analog supply, such as \"-2 A/V\"",
            )
        })?
        .si;
    if !(GAIN.0..=GAIN.1).contains(&gain.abs()) {
        let reason = format!(
            "expected {} A/V to {} A/V of either sign, found {gain} A/V",
            GAIN.0, GAIN.1
        );
        return Err(missing("gain", &reason));
    }
    let rated_a = raw
        .full_scale
        .ok_or_else(|| missing("full_scale", "expected the rated current, such as \"20 A\""))?
        .si;
    let rated_a = Amps(rated_a);
    if !(rated_a > Amps::ZERO && rated_a <= GREATEST_A) {
        let reason = format!("expected a current above 0 A, at most {GREATEST_A}, found {rated_a}");
        return Err(missing("full_scale", &reason));
    }
    let follows_hz = raw
        .max_frequency
        .map_or(FOLLOWS, |frequency| Hertz(frequency.si));
    if !(FOLLOWS_HZ.0..=FOLLOWS_HZ.1).contains(&follows_hz) {
        let reason = format!(
            "expected {} to {}, found {follows_hz}",
            FOLLOWS_HZ.0, FOLLOWS_HZ.1
        );
        return Err(missing("max_frequency", &reason));
    }
    Ok(Analog {
        amps_per_volt: gain,
        rated_a,
        follows_hz,
    })
}

fn linked(source: &Source, raw: &raw_bench::Supply4q) -> Result<Instrument, ConfigError> {
    let complain = |name: &str, reason: String| {
        source.complain(&format!("instruments.supply4q.{name}"), reason)
    };
    supply4q::dialect(&raw.model, None).map_err(|_| {
        let keys = supply4q::DIALECTS.iter().map(|dialect| dialect.key());
        let keys: Vec<&str> = keys.chain([ANALOG]).collect();
        let reason = format!("expected one of {}, found {:?}", keys.join(", "), raw.model);
        complain("model", reason)
    })?;
    let rating = raw
        .rating
        .as_ref()
        .map(|text| {
            let rating = Rating::parse(text).ok_or_else(|| {
                let expected = "expected volts and amperes with the option, such as \"36-12M\"";
                complain("rating", format!("{expected}, found {text:?}"))
            })?;
            supply4q::dialect(&raw.model, Some(rating))
                .map(|_| rating)
                .map_err(|reason| complain("rating", reason))
        })
        .transpose()?;
    let address = raw.address.as_ref().ok_or_else(|| {
        let reason = format!("expected the address of the {}", raw.model);
        complain("address", reason)
    })?;
    let address = address
        .parse()
        .map_err(|error| complain("address", format!("{error}")))?;
    Ok(Instrument {
        model: raw.model.clone(),
        address,
        accept: raw.accept.clone(),
        answer_s: resolve_answer(source, "supply4q", raw.answer)?,
        rating,
        remote_sense: None,
    })
}

/// Longest usual time to an answer, as typed or the default, s.
pub(super) fn resolve_answer(
    source: &Source,
    role: &str,
    typed: Option<Quantity<Duration>>,
) -> Result<Seconds, ConfigError> {
    let answer_s = typed.map_or(ANSWER_S, |quantity| Seconds(quantity.si));
    if (Seconds(0.05)..=Seconds(5.0)).contains(&answer_s) {
        return Ok(answer_s);
    }
    Err(source.complain(
        &format!("instruments.{role}.answer"),
        format!("expected 0.05 s to 5 s, found {answer_s}"),
    ))
}

//! Reports what the watch cannot detect on a bench, so that a person knows it before the run.

use instruments::{instrument::by_key, load};

use bench_plan::config::{Bench, Jig};

/// Returns the quantities that no second instrument on this bench measures, as lines that begin
/// with "not watched".
pub fn unwatched(bench: &Bench) -> Vec<String> {
    let instruments = &bench.instruments;
    let mut lines = Vec::new();
    if instruments.supply.is_some() {
        lines.push(
            "the charger's current: only its own meter measures it. A charger that shows its \
            setting instead of its current is seen by the cell's voltage alone"
                .to_owned(),
        );
    }
    if let Some(load) = &instruments.load {
        lines.push("the load's current: only its own meter measures it".to_owned());
        let usual = by_key(load::DIALECTS, &load.model).and_then(|dialect| dialect.usual_sense());
        if load.remote_sense.or(usual).is_none() {
            lines.push(
                "where the load measures the voltage: instruments.load.remote_sense is not set, \
                and without remote sense the drop of its leads is in every reading under current"
                    .to_owned(),
            );
        }
    }
    if bench.wiring.analog.is_some() {
        lines.push(
            "the bipolar supply's current between two records of the scope: it is analog, without \
            a link, and nothing but the generator's command, which is read back, and the load's \
            voltmeter watch the cell meanwhile. The program cannot switch it: switch it on after \
            the run has asked for it, and off before a hand reaches into the jig"
                .to_owned(),
        );
    }
    if instruments.load.is_none() && instruments.supply4q.is_some() {
        lines.push(
            "the cell's voltage at its terminals: without a load the bipolar supply measures it, \
            with the drop of its leads"
                .to_owned(),
        );
    }
    if instruments.logger.is_none() {
        lines.push("the cell's temperature: the bench has no logger".to_owned());
    }
    if matches!(&instruments.jig, Some(Jig::Device(_))) {
        lines.push(
            "the relays of the jig: they are switched without a feedback of their position"
                .to_owned(),
        );
    }
    lines
        .into_iter()
        .map(|line| format!("not watched: {line}"))
        .collect()
}

//! Clamps another fixture into the simulated jig, as an instrument in place of a person.
//!
//! `JIG:MOUNt CELL|SHUNT|FAKE|BAR`, `JIG:MOUNt?`, `JIG:CELL number` (which of the cells under test,
//! from 1), `JIG:CELL?`, `*IDN?`, `SYSTem:ERRor?`. No such instrument exists; a real bench asks its
//! operator instead.

use instruments_domain::fixture::Fixture;
use scpi::{
    Branch, Leaf, Root,
    error::{Error, ErrorCode},
    tree::Node,
};

use super::{
    MockOptions,
    machine::scpi_device,
    plant::SharedPlant,
    tree::{Answer, Arguments, Fallible, Status, both, common, get, set, text},
    world::World,
};

const QUEUE_DEPTH: usize = 10;

/// The jig.
pub(super) struct Jig {
    world: World,
    status: Status,
    serial_number: String,
}

impl Jig {
    pub(super) fn new(plant: SharedPlant, options: &MockOptions) -> Self {
        Self {
            world: World::new(plant, options.since_s),
            status: Status::new(QUEUE_DEPTH),
            serial_number: options.serial_number.clone(),
        }
    }

    fn mount(&mut self, arguments: &mut Arguments) -> Fallible {
        let fixture = match arguments.word(&["CELL", "SHUNT", "FAKE", "BAR"])? {
            "CELL" => Fixture::Cell,
            "SHUNT" => Fixture::Shunt,
            "BAR" => Fixture::Short,
            _ => Fixture::FakeCell,
        };
        self.world.plant().mount(self.world.now_s, fixture);
        Ok(())
    }

    fn mounted(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        text(match self.world.plant().mounted() {
            Fixture::Cell => "CELL",
            Fixture::Shunt => "SHUNT",
            Fixture::FakeCell => "FAKE",
            Fixture::Short => "BAR",
        })
    }
    fn insert(&mut self, arguments: &mut Arguments) -> Fallible {
        let number = arguments.number("")?;
        let whole = number >= 1.0 && number.fract() == 0.0;
        // A number that is too large for the world is refused by it.
        if whole && self.world.plant().insert(self.world.now_s, number as usize) {
            return Ok(());
        }
        Err(Error::new(ErrorCode::DataOutOfRange))
    }

    fn inserted(&mut self, _: &mut Arguments) -> Fallible<Answer> {
        text(self.world.plant().inserted().to_string())
    }
}

const TREE: Node<'static, Jig> = Root! {
    Leaf! {b"*IDN" => &get(|jig: &mut Jig, _| {
        text(format!("eis-bench,mock-jig,{},{}", jig.serial_number, env!("CARGO_PKG_VERSION")))
    })},
    Leaf! {b"*CLS" => &set(common::cls)},
    Leaf! {b"*OPC" => &both(common::opc, common::opc_query)},
    Branch! {
        b"JIG";
        Leaf! {b"MOUNt" => &both(Jig::mount, Jig::mounted)},
        Leaf! {b"CELL" => &both(Jig::insert, Jig::inserted)}
    },
    Branch! {b"SYSTem"; Branch! {b"ERRor" => &get(common::error_query); Leaf! {b"NEXT" => &get(common::error_query)}}}
};

scpi_device!(Jig, TREE, coded);

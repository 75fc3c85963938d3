//! The test position: the fixture clamped into the jig.

/// Objects that can be clamped into the jig, and the connection of the voltage probes to them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Fixture {
    /// The cell under test, voltage probes on the Kelvin contacts of the jig.
    Cell,
    /// The voltage probes are on the current shunt: a control impedance. The copper fake cell
    /// closes the loop in the jig.
    Shunt,
    /// The copper fake cell in the jig, voltage probes on its Kelvin contacts.
    FakeCell,
    /// A short bar in the jig, voltage probes on its Kelvin contacts: a control impedance of next
    /// to nothing.
    Short,
}

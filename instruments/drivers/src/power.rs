//! What every role that moves current has alike: it can be switched off, looked at and measured.

/// Implements the common part of a role for its dialects, whose messages `switch` turns the output
/// or input on and off.
macro_rules! moves_current {
    ($switch:ident) => {
        impl $crate::instrument::Instrument<dyn Dialect> {
            /// Capabilities of the model.
            pub fn capabilities(&self) -> Capabilities {
                self.dialect.capabilities()
            }

            /// Ways to move no current while it does not go off, the gentlest first.
            pub fn zero(&self) -> Vec<$crate::exchange::Way> {
                self.dialect.zero()
            }

            /// Limits of the current within the instrument, by its own answers.
            pub async fn bounds(&mut self) -> Vec<String> {
                self.bounded_by(self.dialect.bounds()).await
            }

            /// Queries whether it is off, and changes nothing.
            ///
            /// # Errors
            /// The link's errors.
            pub async fn look(&mut self) -> Result<Vec<$crate::exchange::Answer>, LinkError> {
                let (settings, off) = (self.dialect.settings(), self.dialect.$switch(false));
                $crate::exchange::look(&mut self.link, settings, &off).await
            }

            /// Returns the voltage at the terminals and the current, in the direction of the role.
            ///
            /// # Errors
            /// The link's errors, including a reply that is not a number.
            pub async fn measure(&mut self) -> Result<(Volts, Amps), LinkError> {
                let queries = self.dialect.measure();
                self.volts_and_amps(queries).await
            }

            /// Queries the current alone, in half the time.
            ///
            /// # Errors
            /// As [`Self::measure`].
            pub async fn measure_current(&mut self) -> Result<Amps, LinkError> {
                let [_, amps] = self.dialect.measure();
                self.keep_amps(None, amps).await
            }
        }
    };
}
pub(crate) use moves_current;

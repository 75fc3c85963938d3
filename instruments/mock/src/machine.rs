//! Makes a SCPI device of a command tree. The world gets the time of the message, the tree the
//! message, and the queue its errors.

/// Implements what every SCPI mock repeats. `$type` has the fields `world` and `status`, `$tree` is
/// its command tree. With `coded`, errors are queued by their number and text alone, without the
/// detail that the parser adds; `before` names a method that is called before each message.
macro_rules! scpi_device {
    ($type:ty, $tree:expr $(, before $before:ident)?) => {
        $crate::machine::scpi_device!(@ $type, $tree, |error| error $(, $before)?);
    };
    ($type:ty, $tree:expr, coded $(, before $before:ident)?) => {
        $crate::machine::scpi_device!(
            @ $type, $tree, |error| scpi::error::Error::custom(error.get_code(), error.get_message()) $(, $before)?
        );
    };
    (@ $type:ty, $tree:expr, $queued:expr $(, $before:ident)?) => {
        impl $crate::tree::HasStatus for $type {
            fn status(&mut self) -> &mut $crate::tree::Status {
                &mut self.status
            }
        }

        impl scpi::Device for $type {
            fn handle_error(&mut self, error: scpi::error::Error) {
                let queued: fn(scpi::error::Error) -> scpi::error::Error = $queued;
                self.status.push(queued(error));
            }
        }

        impl $crate::Device for $type {
            fn terminator(&self) -> instruments_scpi::decode::Terminator {
                instruments_scpi::decode::Terminator::Lf
            }

            fn handle(&mut self, now_s: f64, message: &[u8]) -> Vec<u8> {
                self.world.now_s = now_s;
                $(self.$before();)?
                $crate::tree::exchange(&$tree, self, message)
            }
        }
    };
}

pub(super) use scpi_device;

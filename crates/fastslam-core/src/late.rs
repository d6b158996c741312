//! What a step does where a draw of paths beside the filter is late.

/// What a step does where a draw of paths beside the filter is not done when it is due.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Late {
    /// It waits, so that results depend on nothing but the log.
    #[default]
    Awaited,
    /// It goes on without it, as the next ones do until it is done: results depend on the machine.
    PutOff,
}

/// How often a draw was late, on this machine.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Lateness {
    /// Steps that have waited for one.
    pub waits: u64,
    /// Steps that have gone on without one.
    pub put_off: u64,
}

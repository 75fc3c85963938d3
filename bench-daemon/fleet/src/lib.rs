//! One bench among many: registration, a queue of work, leases and stops over NATS JetStream.

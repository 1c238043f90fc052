//! Configuration (to come).

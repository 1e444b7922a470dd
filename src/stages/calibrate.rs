//! What the sensor is like, found from the recording itself.

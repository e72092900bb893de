"""The AFM as steps without a clock: contact, cantilever, sample, disturbances, guard, programs and their settings."""

"""The version of the distribution `steer-daemon`, in one place: the build reads it from here."""

VERSION = "0.1.0"

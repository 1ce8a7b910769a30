"""The version of exunet, where every package can read it."""

VERSION = "0.1.0"

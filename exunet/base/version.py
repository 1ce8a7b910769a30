"""The version of exunet, where every room can read it."""

VERSION = "0.1.0"

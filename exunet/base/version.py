"""The version of exunet, where every package can read it without another import."""

VERSION = "0.1.0"

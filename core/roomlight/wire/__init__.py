"""What crosses the network: frames in, light out. `server/WIRE.md` is the document; nothing here opens a socket."""

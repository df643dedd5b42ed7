"""The camera: image sources, the vision process, and the client by which the server sees both."""

"""A trained chain on a local page: it shows touch, spikes and decisions, and sliders change the running stream.

One `deploy.stream.Stream` decides; this package shows it.

- `feeds`: sources of samples: recordings at their own rate, a device, a simulated finger.
- `session`: the thread that feeds the stream and handles the requests of pages.
- `scores`: cost and accuracy of the decided windows, before and after a change.
- `frames`: the data to draw, in bounded pieces, and the mailbox of each page, which keeps the newest pieces.
- `messages`: the requests that a page may send.
- `server`: only loopback, a token in the address, one file.
"""

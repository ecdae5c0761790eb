"""Dead time, hidden spool, play and a monotone characteristic, without a spool sensor."""

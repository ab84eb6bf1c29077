"""A session's camera as JSON, as files of other programs, and the fields over the image that its plots share."""

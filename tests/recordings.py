"""What a recording for the rerun viewer has in it."""


def columns_of(path):
    """Values of each (entity, column) of a recording."""
    from rerun.chunk import RrdReader

    columns = {}
    for chunk in (chunk.to_record_batch() for chunk in RrdReader(path).stream().to_chunks()):
        entity = (chunk.schema.metadata or {}).get(b"rerun:entity_path", b"?").decode()
        for name in chunk.schema.names:
            columns.setdefault((entity, name), []).extend(chunk[name].to_pylist())
    return columns

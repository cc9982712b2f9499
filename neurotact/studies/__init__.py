"""The engine of studies: specs, cells, their computation, tables and claims."""

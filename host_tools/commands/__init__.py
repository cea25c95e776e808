"""The subcommands of ``mcp-asdf``, one module each (see ``host_tools.cli.Command``)."""

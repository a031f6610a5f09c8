"""Terms of the noise, one file each: law, source, what they are measured on."""

// Text that spreadsheets would compute gets an apostrophe, as `csv_text` writes it.
const notComputed = (text) => (/^[=+\-@\t\r]/.test(text) && Number.isNaN(Number(text)) ? `'${text}` : text);

(() => {
  const canvas = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  /** The bytes of a colour on top of another one. */
  const paint = (colour, below) => {
    canvas.fillStyle = `rgb(${below.join()})`;
    canvas.fillRect(0, 0, 1, 1);
    canvas.fillStyle = colour;
    canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data.slice(0, 3)];
  };
  const light = (bytes) => {
    const [r, g, b] = bytes.map((byte) => (byte / 255 <= 0.04045 ? byte / 255 / 12.92 : ((byte / 255 + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const behind = (element) => {
    const chain = [];
    for (let node = element; node; node = node.parentElement) chain.unshift(getComputedStyle(node).backgroundColor);
    return chain.reduce((below, colour) => paint(colour, below), [255, 255, 255]);
  };
  const wrong = [];
  const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (texts.nextNode()) {
    const element = texts.currentNode.parentElement;
    if (texts.currentNode.data.trim() === "" || !element.checkVisibility() || element.closest("noscript, .hidden")) continue;
    const back = behind(element);
    const [a, b] = [light(paint(getComputedStyle(element).color, back)), light(back)];
    const contrast = (Math.max(a, b) + 0.05) / (Math.min(a, b) + 0.05);
    if (contrast < 4.5) wrong.push(`contrast ${contrast.toFixed(2)}: ${texts.currentNode.data}`);
  }
  for (const control of document.querySelectorAll("button, input, select, textarea")) {
    const name = control.getAttribute("aria-label") ?? (control.labels?.[0]?.textContent || control.textContent);
    if (control.checkVisibility() && name.trim() === "") wrong.push(`no name: ${control.outerHTML}`);
    if (control.tabIndex !== 0) wrong.push(`not in the order of Tab: ${control.outerHTML}`);
    const { height, width } = control.getBoundingClientRect();
    if (control.checkVisibility() && (height < 24 || width < 24)) wrong.push(`too small for a finger: ${control.outerHTML}`);
  }
  if (document.documentElement.scrollWidth > innerWidth) wrong.push("wider than the window");
  if (!document.documentElement.lang || !document.title) wrong.push("no language or title");
  return wrong;
})();
